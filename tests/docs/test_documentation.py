"""The documentation is true: its code runs, its JSON parses, its commands exist, its links lead to files."""

from __future__ import annotations

import json
import re
import runpy
import shlex
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import typer
from support.servers import ANY_LOCAL_PORT, plain_session
from support.wire_page import wire_replies

import graspforce
from graspforce.cli import app
from graspforce.service import Server
from graspforce.service.wire import protocol
from graspforce.service.wire.stream_authentication import STATE, MessageSigner, ownership_proof, read_key

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
INTERACTIVE_PAGE = "benchmarks/solvers/index.html"  # of the site; no file of the repository
DEFAULT_ADDRESS = "tcp/127.0.0.1:7450"
MAPPINGS = (".counts", ".latencies", ".clients")  # records by key of a request, or by client
# arrays whose length depends on the run
VARIABLE = (".warnings", ".sentences", "_phases", ".message", ".stages", ".states", ".postures")


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


def linked_paths(page: Path, text: str) -> list[Path]:
    """Targets of the links to files in the text of a page."""
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    return [(page.parent / one).resolve() for one in targets if "://" not in one and not one.startswith("mailto:")]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_to_files_lead_to_files_of_the_repository(page):
    missing = [path for path in linked_paths(page, page.read_text()) if not path.exists()]
    assert not [path for path in missing if path != ROOT / "docs" / INTERACTIVE_PAGE]


@pytest.fixture(scope="module")
def site_hooks():
    """Return the functions of `docs/site_hooks.py`."""
    pytest.importorskip("mkdocs")
    return runpy.run_path(str(ROOT / "docs" / "site_hooks.py"))


@pytest.mark.parametrize("page", [page for page in PAGES if page.is_relative_to(ROOT / "docs")], ids=name)
def test_links_of_the_site_lead_to_its_pages(page, site_hooks):
    """Links to results and examples lead to the pages that the site's hooks add."""
    results = ROOT / "benchmarks" / "results"
    added = {f"benchmarks/{path.relative_to(results).as_posix()}" for path in results.rglob("*.md")}
    added |= {"examples.md", "changelog.md", "bibliography.md", "benchmarks/index.md", INTERACTIVE_PAGE}
    for path in linked_paths(page, site_hooks["on_page_markdown"](page.read_text(), page=None)):
        assert path.is_relative_to(ROOT / "docs"), path
        assert path.exists() or path.relative_to(ROOT / "docs").as_posix() in added, path


def test_every_benchmark_page_is_in_the_list_of_benchmarks():
    results, readme = ROOT / "benchmarks" / "results", (ROOT / "benchmarks" / "README.md").read_text()
    pages = [page.relative_to(results).as_posix() for page in results.rglob("*.md")]
    assert not [page for page in pages if f"](results/{page})" not in readme]


def test_the_architecture_page_names_files_that_exist():
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = [name for name in re.findall(r"`([\w/]+\.(?:py|c|h))`", text) if "/" in name]
    assert named
    places = [Path(graspforce.__file__).parent, ROOT]
    assert not [name for name in named if not any((place / name).is_file() for place in places)]


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_every_headline_figure_of_the_readme_names_its_page():
    table = (ROOT / "README.md").read_text().split("## Numbers")[1].split("\n## ")[0]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    assert rows
    assert all("](benchmarks/results/" in row for row in rows)


def same_structure(ours: object, shown: object, path: str = "") -> None:
    """Check that two records have the same fields, types and lengths. null stands for any value, a number for any number."""
    if ours is None or shown is None:
        return
    if isinstance(ours, dict) and isinstance(shown, dict):
        if not path.endswith(MAPPINGS):
            assert list(ours) == list(shown), path
        for name in shown:
            if name in ours:
                same_structure(ours[name], shown[name], f"{path}.{name}")
    elif isinstance(ours, list) and isinstance(shown, list):
        if not path.endswith(VARIABLE):
            assert len(ours) == len(shown), path
        for one, other in zip(ours, shown, strict=False):
            same_structure(one, other, path)
    elif isinstance(ours, int | float) and not isinstance(ours, bool):
        assert isinstance(shown, int | float), path
    else:
        assert type(ours) is type(shown), path


@pytest.mark.parametrize("codec", ["application/json", "application/msgpack"])
def test_every_request_of_the_wire_page_gets_an_answer(codec):
    """In the page's order, as a program that knows Zenoh and nothing else would send them."""
    shown = [json.loads(block) for block in blocks(wire_replies.TARGET, "json")]
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as server, plain_session(server.addresses[0]) as session:
        answers = list(wire_replies.exchanges(session, codec))
    for exchange, on_page in zip(answers, shown, strict=True):
        assert exchange.kind not in ("state", "signed") or len(exchange.reply["torque"]) == 12
        assert exchange.kind == "cancel" or exchange.reply.get("refusal") is None, exchange
        same_structure(wire_replies.shortened(exchange.reply), on_page, exchange.key)
    assert {exchange.kind for exchange in answers} == {"query", "state", "signed", "followed", "cancel", "token"}
    table = wire_replies.PAGE.read_text().split("## Sizes and rates")[1].split("\n\n")[2]
    columns = slice(2, 6, 2) if codec == "application/json" else slice(3, 7, 2)
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    sizes = {(row[0], row[1].strip("`")): [int(cell) for cell in row[columns]] for row in rows}
    for exchange in answers:
        if (exchange.kind, exchange.key) in sizes and "close" not in exchange.request:
            np.testing.assert_allclose(exchange.sizes, sizes.pop((exchange.kind, exchange.key)), rtol=0.2)
    assert not sizes


def test_the_wire_page_has_an_exchange_for_every_kind_of_key():
    """Of the keys in its table that take queries or messages."""
    requests = wire_replies.page_requests()
    given = set()
    for _, key, _ in requests:
        for place, name in (
            ("hands/[^/]+", "hands/<hand>"),
            ("streams/[^/]+", "streams/<id>"),
            ("setups/[^/]+", "setups/<id>"),
            ("plans/[^/]+$", "plans/<id>/progress"),
            ("^schema/.+", "schema/<name>"),
            ("^alive/.+", "alive/<server>"),
        ):
            key = re.sub(place, name, key)
        given.add(key)
    table = wire_replies.PAGE.read_text().split("| key | request | reply |")[1].split("\n\n")[0]
    named = set(re.findall(r"^\| `([^`]+)`", table, flags=re.M)) - {"streams/<id>/state"}  # no query
    assert given == named
    assert {"state", "followed", "cancel"} <= {kind for kind, _, _ in requests}


def test_the_worked_bytes_of_authentication_are_right():
    """The table on the page: payloads in both encodings, counter and code, and the proof of the owner."""
    part = wire_replies.PAGE.read_text().split("Check your program with these bytes")[1].split("\n## ")[0]
    key, owner = (read_key(text) for text in re.findall(r"`([0-9a-f]{64})`", part))
    rows = {row[0]: [cell.strip("`") for cell in row[1:]] for row in re.findall(r"\| (\w+) \| (.+?) \| (.+?) \|\n", part)}
    in_json, in_msgpack = rows["payload"][0].encode(), bytes.fromhex(rows["payload"][1])
    record = protocol.decode(in_json, protocol.JSON)
    assert protocol.encode(record, protocol.JSON) == in_json
    assert protocol.encode(record, protocol.MSGPACK) == in_msgpack
    for payload, counter, code in zip((in_json, in_msgpack), rows["counter"], rows["code"], strict=True):
        assert MessageSigner(key, STATE).sign(payload).hex() == counter + code
    assert ownership_proof(key, "my-stream") == owner.hex()
