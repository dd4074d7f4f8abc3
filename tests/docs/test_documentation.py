"""The documentation is true: its code runs, its JSON parses, its commands exist, its links lead somewhere."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import matplotlib
import pytest
import typer
import zenoh
from support.servers import ANY_LOCAL_PORT, TIMEOUT, plain_session

from graspforce.cli import app
from graspforce.service import Server
from graspforce.service.wire import protocol

matplotlib.use("Agg")
ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "benchmarks" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
PRINTED = {  # what a reader must see where the numbers are known
    "README.md": ("optimal", "30 is required and at most 20 can be supplied"),
    "docs/getting_started.md": ("optimal", "True"),
    "docs/concepts/certificates.md": ("infeasible", "30 is required and at most 20 can be supplied", "1.5000"),
    "docs/force_problem.md": ('"status": "optimal"',),
}
DEFAULT_ADDRESS = "tcp/127.0.0.1:7450"


def blocks(page: Path, language: str) -> list[str]:
    """Code blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), flags=re.S | re.M)


def pages_with(language: str) -> list[Path]:
    return [page for page in PAGES if blocks(page, language)]


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.fixture(scope="module")
def address():
    """Return the address of a server with the hands that the pages use."""
    with Server(["dlr_hit2", "four_finger"], listen=ANY_LOCAL_PORT) as server:
        yield server.addresses[0]


@pytest.mark.parametrize("page", [p for p in pages_with("python") if p.parent.name != "benchmarks"], ids=name)
def test_python_blocks_run_in_their_order(page, address, monkeypatch, tmp_path, capsys):
    """One namespace for a page; requests go to a live server."""
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    for block in blocks(page, "python"):
        code = block.replace("Client()", f'Client("{address}")').replace(DEFAULT_ADDRESS, address)
        exec(compile(code, name(page), "exec"), namespace)
    printed = capsys.readouterr().out
    for expected in PRINTED.get(name(page), ()):
        assert expected in printed, f"{name(page)} prints {expected}"


@pytest.mark.parametrize("page", pages_with("json"), ids=name)
def test_json_blocks_parse(page):
    for block in blocks(page, "json"):
        json.loads(block)


def command_lines() -> list[tuple[str, str]]:
    """(page, command line) of every use of the command in a shell block."""
    found = []
    for page in pages_with("sh"):
        for block in blocks(page, "sh"):
            for line in block.replace("\\\n", " ").splitlines():
                for part in line.split("#")[0].split("|"):
                    if part.strip().startswith("graspforce "):
                        found.append((name(page), part.strip().rstrip("&").strip()))
    return found


@pytest.mark.parametrize(("page", "line"), command_lines())
def test_commands_take_the_options_that_pages_show(page, line):
    words = shlex.split(line)[1:]
    command = typer.main.get_command(app)
    context = command.make_context("graspforce", words, resilient_parsing=False, ignore_unknown_options=False)
    while hasattr(command, "resolve_command") and (
        rest := [*context._protected_args, *context.args] if hasattr(context, "_protected_args") else context.args
    ):
        called, command, rest = command.resolve_command(context, rest)
        context = command.make_context(called, list(rest), parent=context)
    assert context.params is not None


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_to_files_lead_somewhere(page):
    built = {"examples.md", "changelog.md", "bibliography.md"}  # pages that the site's hooks add
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if "://" in target or target.startswith("mailto:"):
            continue
        path = (page.parent / target).resolve()
        inside = path.relative_to(ROOT / "docs").as_posix() if path.is_relative_to(ROOT / "docs") else ""
        if inside in built or inside.startswith("benchmarks/"):
            result = ROOT / "benchmarks" / "results" / inside.removeprefix("benchmarks/")
            assert inside in {*built, "benchmarks/index.md"} or result.exists(), f"{name(page)}: {target}"
            continue
        assert path.exists(), f"{name(page)}: {target}"


def test_the_architecture_page_names_files_that_exist():
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = [name for name in re.findall(r"`([\w/]+\.(?:py|c|h))`", text) if "/" in name]
    assert named
    places = [ROOT / "graspforce", ROOT]
    assert not [name for name in named if not any((place / name).is_file() for place in places)]


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_every_headline_figure_of_the_readme_names_its_page():
    table = (ROOT / "README.md").read_text().split("## Numbers")[1].split("\n## ")[0]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    assert rows
    assert all("](benchmarks/results/" in row for row in rows)


def wire_requests() -> list[tuple[str, str, str]]:
    """(query or state, key, JSON) of every request on the page about the wire."""
    return re.findall(r"<!-- (query|state) (\S+) -->\n```json\n(.*?)```", (ROOT / "docs" / "wire.md").read_text(), flags=re.S)


@pytest.mark.parametrize("codec", ["application/json", "application/msgpack"])
def test_every_request_of_the_wire_page_gets_an_answer(codec):
    """In the page's order, as a program that knows Zenoh and nothing else would send them."""
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as server, plain_session(server.addresses[0]) as session:
        for kind, key, text in wire_requests():
            payload = protocol.encode(json.loads(text), codec)
            if kind == "state":
                commands = session.declare_subscriber(f"graspforce/1/{key}/command", zenoh.handlers.FifoChannel(4))
                session.put(f"graspforce/1/{key}/state", payload, encoding=codec)
                command = protocol.decode(commands.recv().payload.to_bytes(), codec)
                assert len(command["torque"]) == 12
                continue
            (reply,) = session.get(f"graspforce/1/{key}", payload=payload, encoding=codec, timeout=TIMEOUT)
            assert reply.err is None, reply.err.payload.to_bytes()
            answer = protocol.decode(reply.ok.payload.to_bytes(), codec)
            assert answer.get("refusal") is None, answer
