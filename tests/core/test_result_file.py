import subprocess
import sys

import pytest

from graspforce.core.errors import InvalidInput
from graspforce.core.result_file import ResultFile, read_results

SCHEMA = "graspforce/test/1"
WRITER = """
import sys, pathlib
from graspforce.core.result_file import ResultFile
file = ResultFile(pathlib.Path(sys.argv[1]), "graspforce/test/1", {})
print("open", flush=True)
sys.stdin.read()
"""


def test_results_are_read_back_with_their_conditions(tmp_path):
    path = tmp_path / "folder" / "results.jsonl"
    with ResultFile(path, SCHEMA, {"duration": 2.0, "names": ("a", "b")}) as file:
        file.append({"seed": 0})
        file.append({"seed": 1})
    conditions, records = read_results(path, SCHEMA)
    assert conditions == {"schema": SCHEMA, "duration": 2.0, "names": ["a", "b"]}
    assert records == file.records == [{"seed": 0}, {"seed": 1}]


def test_partial_last_line_is_replaced_by_the_next_result(tmp_path):
    path = tmp_path / "results.jsonl"
    with ResultFile(path, SCHEMA, {}) as file:
        file.append({"seed": 0})
    with path.open("a", encoding="utf-8") as killed:
        killed.write('{"label": "5 µ')
    with ResultFile(path, SCHEMA, {}) as file:
        file.append({"seed": 1})
    assert read_results(path, SCHEMA)[1] == [{"seed": 0}, {"seed": 1}]


def test_second_writer_is_rejected_until_the_first_closes(tmp_path):
    path = tmp_path / "results.jsonl"
    with ResultFile(path, SCHEMA, {}) as first:
        with pytest.raises(InvalidInput, match="a file that no other process is writing"):
            ResultFile(path, SCHEMA, {})
        first.append({"seed": 0})
        assert read_results(path, SCHEMA)[1] == [{"seed": 0}]  # reading needs no lock
    with ResultFile(path, SCHEMA, {}) as second:
        assert second.records == [{"seed": 0}]


def test_lock_ends_with_a_killed_process(tmp_path):
    path = tmp_path / "results.jsonl"
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout.readline() == "open\n"
        with pytest.raises(InvalidInput, match="no other process"):
            ResultFile(path, SCHEMA, {})
        writer.kill()
        writer.wait(10)
    ResultFile(path, SCHEMA, {}).close()


@pytest.mark.parametrize("text", ["one line", "no JSON\n", '{"schema": "another"}\n', "[1]\n"])
def test_other_files_are_neither_read_nor_changed(tmp_path, text):
    path = tmp_path / "notes.txt"
    path.write_text(text)
    with pytest.raises(InvalidInput):
        ResultFile(path, SCHEMA, {})
    with pytest.raises(InvalidInput):
        read_results(path, SCHEMA)
    assert path.read_text() == text


def test_conditions_must_be_those_of_the_file(tmp_path):
    path = tmp_path / "results.jsonl"
    ResultFile(path, SCHEMA, {"duration": 1.0}).close()
    with pytest.raises(InvalidInput, match="it differs in duration, plant"):
        ResultFile(path, SCHEMA, {"duration": 2.0, "plant": "links"})
    with pytest.raises(InvalidInput, match="results"):
        read_results(tmp_path / "missing.jsonl", SCHEMA)
