"""Files are replaced whole or not at all."""

from __future__ import annotations

import stat

import pytest

from graspforce.core.whole_file import replace_file, write_text


def test_file_is_replaced(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "first")
    path.chmod(0o640)
    write_text(path, "größer")
    assert path.read_text(encoding="utf-8") == "größer"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("exists", [True, False])
def test_failed_write_leaves_the_previous_file(tmp_path, exists):
    path = tmp_path / "a.npz"
    if exists:
        path.write_text("previous")

    def fail():
        with replace_file(path) as temporary:
            temporary.write_text("half of the new")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        fail()
    assert [each.read_text() for each in tmp_path.iterdir()] == (["previous"] if exists else [])


def test_full_disk_leaves_the_previous_file(tmp_path):
    resource = pytest.importorskip("resource")
    signal = pytest.importorskip("signal")
    path = tmp_path / "a.txt"
    path.write_text("previous")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # writing beyond the limit then raises OSError
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
        with pytest.raises(OSError, match="too large"):
            write_text(path, "x" * 2000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert [each.read_text() for each in tmp_path.iterdir()] == ["previous"]


def test_symbolic_link_is_followed(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("previous")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_device_is_written_directly():
    write_text("/dev/null", "nothing")
