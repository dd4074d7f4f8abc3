"""Ctrl-C in a run: what there is is shown and saved; a second one ends the command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from graspforce.cli import main
from graspforce.cli.interruption import Interruption
from graspforce.simulation import Recording

COMMAND = "import sys; from graspforce.cli import main; sys.exit(main(sys.argv[1:]))"
TIMEOUT = 60.0  # s


def test_interrupted_run_saves_its_recording(tmp_path):
    file = tmp_path / "run.npz"
    words = [sys.executable, "-c", COMMAND, "simulate", "--reference", "still", "--duration", "1000", "--save", str(file)]
    environment = {**os.environ, "FORCE_COLOR": "1"}  # progress is shown, which tells that the run has begun
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment) as process:
        try:
            assert process.stderr is not None
            shown, deadline = b"", time.monotonic() + TIMEOUT
            while b"Simulating, tracking" not in shown:
                assert time.monotonic() < deadline
                shown += os.read(process.stderr.fileno(), 4096)
            process.send_signal(signal.SIGINT)
            _, rest = process.communicate(timeout=TIMEOUT)
        finally:
            process.kill()
    assert b"Interrupted: the results are those so far" in shown + rest
    assert process.returncode == 0
    assert 0.0 < Recording.load(file).t[-1] < 1000.0


def test_second_interruption_raises():
    before = signal.getsignal(signal.SIGINT)
    with Interruption() as interruption:
        os.kill(os.getpid(), signal.SIGINT)
        assert interruption.is_requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_interrupted_search_ends_without_a_traceback(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("graspforce.cli.options.find_grasp", interrupted)
    assert main(["simulate"]) == 130
    assert capsys.readouterr().err == "Error: interrupted\n"
