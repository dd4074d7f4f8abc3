"""The workflows of the repository: they parse, and code of a pull request never runs with a right to write."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmarks import smoke_comment

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
HISTORY = ROOT / "benchmarks" / "results" / "suite-smoke" / "history.json"


class UniqueKeys(yaml.SafeLoader):
    """Loader that refuses a key that occurs twice, of which YAML keeps the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=deep) for key, _ in node.value]
        assert len(keys) == len(set(keys)), f"line {node.start_mark.line + 1}: a key occurs twice: {keys}"
        return super().construct_mapping(node, deep)


def workflow(path: Path) -> dict[str, Any]:
    """Return a workflow; its triggers are under "on", which YAML 1.1 reads as true."""
    record = yaml.load(path.read_text(encoding="utf-8"), UniqueKeys)  # derived from the safe loader
    record["on"] = record.pop(True)
    return record


def steps(record: dict[str, Any]) -> list[dict[str, Any]]:
    return [step for job in record["jobs"].values() for step in job["steps"]]


def grants_writing(record: dict[str, Any]) -> bool:
    """Return whether a workflow or one of its jobs can write to the repository; by default GitHub decides."""
    granted = [record.get("permissions"), *(job.get("permissions") for job in record["jobs"].values())]
    return any(one == "write-all" or (isinstance(one, dict) and "write" in one.values()) for one in granted)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_job_has_a_machine_and_steps_that_do_one_thing(path: Path) -> None:
    record = workflow(path)
    assert record["name"] == path.stem
    assert record["on"]
    for job in record["jobs"].values():
        assert isinstance(job["runs-on"], str)
    for step in steps(record):
        assert ("uses" in step) != ("run" in step), step
        if "uses" in step:
            assert re.fullmatch(r"[\w-]+/[\w-]+@v\d+(\.\d+)*", step["uses"]), step


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_workflows_that_can_write_run_no_code_of_a_pull_request(path: Path) -> None:
    record = workflow(path)
    if "workflow_run" in record["on"] or "pull_request_target" in record["on"]:
        assert "pull_request" not in record["on"]
        assert not any(step.get("uses", "").startswith("actions/checkout") or "run" in step for step in steps(record))
        for step in steps(record):
            assert "${{" not in step.get("with", {}).get("script", "")  # names of branches would become code
    else:
        assert not grants_writing(record)


def test_comment_follows_the_smoke_workflow_and_reads_its_artifact() -> None:
    smoke, comment = (workflow(ROOT / ".github" / "workflows" / f"{name}.yml") for name in ("smoke", "smoke-comment"))
    assert comment["on"]["workflow_run"] == {"workflows": [smoke["name"]], "types": ["completed"]}
    assert comment["permissions"] == {"actions": "read", "pull-requests": "write"}
    assert smoke["permissions"] == {"contents": "read"}
    uploaded = {step["with"]["name"]: step["with"]["path"] for step in steps(smoke) if "upload" in step.get("uses", "")}
    download, post = steps(comment)
    name, folder = download["with"]["name"], download["with"]["path"]
    assert f'"{folder}/{Path(uploaded[name]).name}"' in post["with"]["script"]
    assert any(f"> {uploaded[name]}" in step.get("run", "") for step in steps(smoke))


def packages_of(extra: str) -> set[str]:
    """Return the packages that an extra of the project installs, with those of the extras that it names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    packages, extras = {project["name"]}, [extra]
    requirements = list(project["dependencies"])
    for one in extras:  # grows in the loop
        requirements += project["optional-dependencies"][one]
        named = [text for text in project["optional-dependencies"][one] if text.startswith("graspforce[")]
        extras += [each for text in named for each in text[len("graspforce[") : -1].split(",") if each not in extras]
    return packages | {re.split(r"[\[<>=;]", text)[0] for text in requirements}


def test_smoke_installs_every_solver_of_the_benchmark() -> None:
    """A solver that a pull request adds to the extra takes part; one whose package is not in the extra fails here."""
    smoke = workflow(ROOT / ".github" / "workflows" / "smoke.yml")
    assert any(step.get("run") == 'pip install ".[bench]"' for step in steps(smoke))
    installed = packages_of("bench")
    for adapter in sorted((ROOT / "graspforce" / "bench" / "solvers").glob("[!_]*.py")):
        [package] = re.findall(r'^PACKAGE = "(.+)"$', adapter.read_text(), flags=re.M)
        assert package in installed, adapter.name


# A pull request, its comments, and a recorder of calls in place of GitHub; as actions/github-script runs a script.
FAKE = """
const state = JSON.parse(process.argv[2]), calls = [];
const record = name => async values => { calls.push([name, values]); return {data: state.pulls}; };
const github = {
  rest: {
    pulls: {list: record("list")},
    issues: {listComments: null, updateComment: record("update"), createComment: record("create")},
  },
  paginate: async () => state.comments,
};
const run = {id: 1, head_sha: state.sha, head_branch: "mine", html_url: "URL", head_repository: {owner: {login: "me"}}};
const context = {repo: {owner: "us", repo: "ours"}, payload: {workflow_run: run}};
const core = {notice: text => calls.push(["notice", text])};
(async () => { SCRIPT
})().then(() => console.log(JSON.stringify(calls)));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
@pytest.mark.parametrize(
    ("sha", "comments", "expected"),
    [
        ("new", [], "create"),
        ("new", [{"id": 5, "user": {"type": "User"}, "body": "<!-- graspforce smoke --> mine"}], "create"),
        ("new", [{"id": 7, "user": {"type": "Bot"}, "body": "<!-- graspforce smoke -->\nold"}], "update"),
        ("old", [], "notice"),
    ],
)
def test_comment_is_updated_and_belongs_to_the_commit(
    sha: str, comments: list[dict[str, Any]], expected: str, tmp_path: Path
) -> None:
    script = steps(workflow(ROOT / ".github" / "workflows" / "smoke-comment.yml"))[1]["with"]["script"]
    (tmp_path / "artifact").mkdir()
    (tmp_path / "artifact" / "comment.md").write_text("the table")
    (tmp_path / "script.js").write_text(FAKE.replace("SCRIPT", script))
    state = {"sha": sha, "pulls": [{"number": 3, "head": {"sha": "new"}}], "comments": comments}
    ran = subprocess.run(
        ["node", "script.js", json.dumps(state)], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60
    )
    listed, (name, values) = json.loads(ran.stdout)
    assert (listed[1]["head"], listed[1]["owner"]) == ("me:mine", "us")
    assert name == expected
    if name == "notice":
        return
    assert (values.get("issue_number"), values.get("comment_id")) == ((3, None) if name == "create" else (None, 7))
    assert values["body"].startswith("<!-- graspforce smoke -->\nthe table\n")
    assert "Commit new" in values["body"]


def test_comment_has_the_table_of_every_solver(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["smoke_comment", str(HISTORY)])
    smoke_comment.main()
    text = capsys.readouterr().out
    for solver in {entry["solver"] for entry in json.loads(HISTORY.read_text())}:
        assert f"\n| {solver} | " in text
    assert "problem data" in text
