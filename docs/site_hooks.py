"""Add pages that are written elsewhere: benchmark results, the changelog, the bibliography and the example gallery.

The interactive page of the benchmark is written here, from the record of the whole suite. Links to results and examples in the
repository become links to these pages.
"""

from __future__ import annotations

import ast
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from graspforce.bench import outcome, site

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
SUITE_RECORD = RESULTS / "records" / "suite" / "run-1.jsonl.xz"


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages and the pictures that they show."""
    pages = {"changelog.md": (ROOT / "CHANGELOG.md").read_text(), "bibliography.md": bibliography(), "examples.md": gallery()}
    for page in sorted(RESULTS.rglob("*.md")):
        name = f"benchmarks/{page.relative_to(RESULTS).as_posix()}"
        pages[name] = re.sub(r"\]\((?:\.\./)+(?!results|media)[^)]*\.(?:py|toml)\)", "](../architecture.md)", page.read_text())
    pages["benchmarks/index.md"] = results_index((ROOT / "benchmarks" / "README.md").read_text())
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for picture in sorted(RESULTS.rglob("*.png")):
        name = f"benchmarks/{picture.relative_to(RESULTS).as_posix()}"
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    files.append(File.generated(config, "benchmarks/solvers/index.html", content=solver_page()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the links of a page to results and examples in the repository by links to the pages of this site.

    Args:
        markdown: text of the page.
    """
    results = re.sub(r"\]\(\.\./((?:\.\./)*)benchmarks/results/", r"](\1benchmarks/", markdown)
    return re.sub(r"\]\(\.\./((?:\.\./)*)examples\)", r"](\1examples.md)", results)


def solver_page() -> str:
    """Return the interactive page of the whole suite in all units, with the history of earlier versions."""
    conditions, outcomes = outcome.load(SUITE_RECORD)
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(RESULTS / "suite" / "history.json", folder)
        page = site.write_site(Path(folder), conditions, outcomes, "python -m benchmarks.suite run --save FILE")
        return page.read_text()


def results_index(readme: str) -> str:
    """Return the tables of benchmarks from `benchmarks/README.md`, with links to the pages of this site.

    Args:
        readme: text of the file.
    """
    tables = readme.partition("\n## Other benchmarks\n")[2].replace("](results/", "](")
    return "# Benchmarks\n" + re.sub(r"\[([^\]]+)\]\(#[^)]*\)", r"\1", tables).replace("\n### ", "\n## ")


def bibliography() -> str:
    """Return the entries of references.bib as a list, in the order of their keys."""
    text = (ROOT / "docs" / "references.bib").read_text()
    rows = []
    for entry in re.split(r"\n@", "\n" + text)[1:]:
        fields = dict(re.findall(r"(\w+) = \{((?:[^{}]|\{[^{}]*\})*)\}", entry))
        plain = {name: re.sub(r"[{}]|\\(?=[_&])", "", value) for name, value in fields.items()}
        people = [" ".join(reversed(person.split(", "))) for person in plain["author"].split(" and ")]
        venue = plain.get("journal") or plain.get("booktitle") or plain.get("publisher") or plain.get("institution")
        venue = venue or plain.get("howpublished", "")
        number = plain.get("volume") or plain.get("number", "")
        tail = ", ".join(part for part in (f"*{venue}*" if venue else "", number, plain["year"]) if part)
        link = f" [doi:{plain['doi']}](https://doi.org/{plain['doi']})" if "doi" in plain else ""
        rows.append(f"- {', '.join(people)}. **{plain['title']}**. {tail}.{link}")
    return "# Bibliography\n\n" + "\n".join(sorted(rows, key=str.casefold)) + "\n"


def gallery() -> str:
    """Return the gallery of examples: what each shows, its picture and its code."""
    parts = ["# Examples", "", "Each script is short and shows one thing. Run one with `python examples/NAME.py`.", ""]
    for script in sorted((ROOT / "examples").glob("*.py")):
        text = script.read_text()
        title, _, rest = (ast.get_docstring(ast.parse(text)) or script.stem).partition("\n")
        code = text.split('"""', 2)[2].strip()
        parts += [f"## {title.rstrip('.')}", "", rest.strip(), ""]
        if (ROOT / "docs" / "media" / "examples" / f"{script.stem}.png").exists():
            parts += [f"![{title}](media/examples/{script.stem}.png)", ""]
        parts += [f"`examples/{script.name}`", "", "```python", code, "```", ""]
    return "\n".join(parts)
