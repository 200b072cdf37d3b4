"""How the command ends: by an error, by Ctrl-C, or by an output that is closed."""

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
    """Print an error in one line, and end with an exit code."""
    print(f"jentry: {message}", file=sys.stderr)
    sys.exit(code)


def open_streams() -> None:
    """Let every text be printed, also on a closed stream or in another encoding."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # the parent process closed it
            setattr(sys, name, open(os.devnull, "w"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def forget_output() -> None:
    """Drop unwritten output, which Python would try to write again as it ends."""
    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


def as_process(run: Callable[[], None]) -> NoReturn:
    """Run a command, and end the process with its exit code.

    The process ends without Python's own shutdown. That would take up to a second to
    destroy what JAX has built, and must not happen while a thread still computes. All
    files have been written by then.
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
    """Context in which Ctrl-C ends the process immediately.

    An exception in the middle of an import or of a callback would print a traceback or be
    lost. Files are written whole or not at all, so nothing has to be repaired.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread handles signals
        return
    before = signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def rounding_off(advice: str) -> Iterator[Callable[[], None]]:
    """Context in which Ctrl-C ends the command and prints advice.

    It yields a function to call regularly. The function raises an interruption that was
    lost where Python cannot pass exceptions on, in a callback of JAX.
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
        # An interrupted object, such as a half-written file, may fail to close.
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
        if pressed:  # JAX has made another exception of the interruption
            traceback.clear_frames(error.__traceback__)
            fail(f"interrupted; {advice}", 130)
        raise
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook
