"""How the command ends: by an error, by Ctrl-C, by an output that nobody reads."""

import contextlib
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import NoReturn


def fail(message: str, code: int) -> NoReturn:
    """Say why in one line, and end with an exit code."""
    print(f"jentry: {message}", file=sys.stderr)
    sys.exit(code)


def open_streams() -> None:
    """Make what is printed arrive as far as it can, whatever the terminal knows."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by who started the process
            setattr(sys, name, open(os.devnull, "w"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def forget_output() -> None:
    """Keep Python from writing, as it ends, what could not be written."""
    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


def as_process(run: Callable[[], None]) -> NoReturn:
    """Run a command, and end the process with its exit code.

    Python would take apart first what JAX has built, which takes up to a second, and must
    not be done while a thread still computes. All files have been written by then.
    """
    code: int | str | None = 0
    try:
        run()
    except SystemExit as ended:
        code = ended.code
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        code = 1
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code if isinstance(code, int) else int(code is not None))


def _leave(number, frame) -> NoReturn:
    os.write(2, b"jentry: interrupted\n")
    os._exit(130)


@contextlib.contextmanager
def leaving_at_once() -> Iterator[None]:
    """Ctrl-C ends the process there and then.

    An exception in the middle of an import or of a callback would be a traceback, or
    lost. What is written is written whole or not at all, so nothing has to be put right.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # which has no say in signals
        return
    before = signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def rounding_off(advice: str) -> Iterator[Callable[[], None]]:
    """Ctrl-C ends what is done here with a word of advice.

    Gives a function to be called now and then: it notices an interruption that was lost
    where Python cannot pass exceptions on, in a callback of JAX.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    pressed = False

    def press(number, frame):
        nonlocal pressed
        pressed = True
        raise KeyboardInterrupt

    def look() -> None:
        if pressed:
            raise KeyboardInterrupt

    def not_passed_on(lost, hook=sys.unraisablehook):
        # What the interruption has torn, such as a half-written file, may fail to close.
        if not pressed and not isinstance(lost.exc_value, KeyboardInterrupt):
            hook(lost)

    before, hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
    sys.unraisablehook = not_passed_on
    signal.signal(signal.SIGINT, press)
    try:
        yield look
    except KeyboardInterrupt as interruption:
        traceback.clear_frames(interruption.__traceback__)
        fail(f"interrupted; {advice}", 130)
    except Exception as error:
        if pressed:  # what JAX has made of it
            traceback.clear_frames(error.__traceback__)
            fail(f"interrupted; {advice}", 130)
        raise
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook
