"""Progress without a terminal: one line every few seconds."""

from jentry.cli import progress
from jentry.cli.progress import reported


def test_a_line_every_so_often(capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with reported(1000) as told:
        told(200)  # stored before
        for seconds, stored in ((4.0, 300), (8.0, 500), (3.0, 600), (10.0, 1000)):
            now[0] += seconds
            told(stored)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "500 of 1000 runs, 25 runs/s, 20 s left",
        "1000 of 1000 runs, 32 runs/s, 0 s left",
    ]
    with reported(1000, quiet=True) as told:
        now[0] += 99.0
        told(3)
    assert capsys.readouterr() == ("", "")
