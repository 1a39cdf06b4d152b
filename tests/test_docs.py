"""The documentation's examples run as printed; its links lead somewhere."""

import ast
import doctest
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import nbformat
import pytest
import typer
import yaml

import dssc_jax as dj
from benchmarks.pages import PAGES as PAGES_OF
from benchmarks.pages import type_name
from dssc_jax.cli.application import app
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.study.sections import FIXED_TABLES
from tests.page_examples import BLOCK

ROOT = Path(__file__).parents[1]
EVERY = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PAGES = sorted(str(page.relative_to(ROOT)) for page in EVERY if BLOCK.search(page.read_text()))
SOURCE = ROOT / "src"
WITH_EXAMPLES = sorted(
    ".".join(file.relative_to(SOURCE).with_suffix("").parts)
    for file in SOURCE.rglob("*.py")
    if re.search(r"^ +>>> ", file.read_text(), re.MULTILINE)
)
LANGUAGES = {"sh", "python", "toml", "c"}


@pytest.mark.long
@pytest.mark.parametrize("pages", [PAGES[i::4] for i in range(4)], ids=["first", "second", "third", "fourth"])
def test_examples_run(pages, tmp_path):
    """A quarter of the pages in a process that imports the package once."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    command = [sys.executable, str(ROOT / "tests" / "page_examples.py"), *(str(ROOT / page) for page in pages)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for page in pages:
        assert f"\n--- {Path(page).name}: " in f"\n{done.stdout}"


def test_an_example_that_fails_is_told(tmp_path):
    """Of any kind: a command's exit code, an exception."""
    for text, told in (
        ("```sh\ndssc-jax studies\ndssc-jax info nothing-like-it\n```", "exit code 2"),
        ("```sh\nfalse | true\nexit 3\n```", "exit code 3"),
        ("```python\nimport dssc_jax as dj\ndj.Study.load('none.toml')\n```", "none.toml"),
    ):
        (tmp_path / "page.md").write_text(text)
        command = [sys.executable, str(ROOT / "tests" / "page_examples.py"), "page.md"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 1
        assert told in done.stderr


def test_every_block_is_of_a_language_that_runs():
    for page in EVERY:
        for language, text in BLOCK.findall(page.read_text()):
            assert language in LANGUAGES, f"a block that is not tested; indent it by four blanks:\n{text}"


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_of_docstrings(module, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = doctest.testmod(importlib.import_module(module))
    assert found.attempted > 0
    assert found.failed == 0


def test_links_lead_somewhere():
    links = [(page, link) for page in EVERY for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text())]
    assert len(links) > 100
    for page, link in links:
        assert (page.parent / link).exists(), f"{page.name}: {link}"


def text_of(path):
    """A page's text, or that of a notebook's cells."""
    if path.suffix == ".ipynb":
        return "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells)
    return path.read_text()


def named_commands(text):
    """Commands that a text names, and what follows each."""
    return re.findall(r"\bdssc-jax ([a-z]+(?:-[a-z]+)*)([^`|#\n]*)", text)


def named_targets(text):
    """Targets of make that a text names."""
    return re.findall(r"(?:`|^ {4}|^(?=make \w+ +#))make (\w+)", text, re.MULTILINE)


def named_files(text):
    """Files of the repository that a text names."""
    return re.findall(r"\b(?:docs|studies|notebooks|tests|benchmarks)/[\w/]+\.\w+", text)


@pytest.mark.parametrize("path", [*EVERY, *NOTEBOOKS], ids=lambda path: path.name)
def test_what_a_page_names_exists(path):
    """Commands with their options, make's targets, files of the repository."""
    text = text_of(path)
    commands = typer.main.get_command(app).commands
    for name, rest in named_commands(text):
        options = {flag for option in commands[name].params for flag in option.opts} | {"--help"}
        assert set(re.findall(r"--[a-z-]+", rest)) <= options, f"{name}{rest}"
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(named_targets(text)) <= set(targets)
    for file in named_files(text):
        assert (ROOT / file).exists(), file


def test_the_names_of_pages_are_found():
    """So that the test above compares something."""
    texts = [text_of(path) for path in EVERY]
    assert sum(len(named_commands(text)) for text in texts) > 100
    assert len({name for text in texts for name, _ in named_commands(text)}) > 15
    assert sum(len(named_targets(text)) for text in texts) > 15
    assert sum(len(named_files(text)) for text in texts) > 15


@pytest.mark.parametrize("page", PAGES_OF)
def test_generated_pages_are_current(page):
    """`make pages` writes them."""
    assert (ROOT / "docs" / page).read_text() == PAGES_OF[page]()


def test_types_of_the_study_file():
    """Of texts with rules, of what may be absent, and of lists of points."""
    model = FIXED_TABLES["units"]
    assert {type_name(field.annotation) for field in model.model_fields.values()} == {"text"}
    assert type_name(FIXED_TABLES["envelope"].model_fields["upper"].annotation) == "list"
    assert type_name(FIXED_TABLES["requirement"].model_fields["max"].annotation) == "number"


def arguments_of(node):
    """Names that the documentation of a function or class may describe: its arguments, fields and those of __init__."""
    if isinstance(node, ast.FunctionDef):
        return {argument.arg for argument in ast.walk(node.args) if isinstance(argument, ast.arg)}
    names = {
        part.target.id for part in node.body if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
    }
    begin = [part for part in node.body if isinstance(part, ast.FunctionDef) and part.name == "__init__"]
    return names.union(*(arguments_of(part) for part in begin))


def described_but_absent(text):
    """Definitions of a module's text that document arguments which they do not have, with these arguments."""
    found = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            section = re.search(r"^Args:\n((?: {4}.*\n?|\n)+)", ast.get_docstring(node) or "", re.MULTILINE)
            described = re.findall(r"^ {4}(\w+(?:, \w+)*):", section[1], re.MULTILINE) if section else []
            absent = {name for names in described for name in names.split(", ")} - arguments_of(node)
            if absent:
                found[node.name] = sorted(absent)
    return found


def test_documented_arguments_exist():
    assert {
        str(file): absent for file in SOURCE.rglob("*.py") if (absent := described_but_absent(file.read_text()))
    } == {}


def test_a_documented_argument_that_was_renamed_is_found():
    old = 'def f(x):\n    """Double.\n\n    Args:\n        y: A number.\n    """\n'
    assert described_but_absent(old) == {"f": ["y"]}
    assert described_but_absent(old.replace("(x)", "(y)")) == {}
    assert described_but_absent('class C:\n    """A.\n\n    Args:\n        a: One.\n    """\n\n    b: int\n') == {
        "C": ["a"]
    }


def test_every_source_is_in_the_bibliography():
    """By its first author's name and its year."""
    page = " ".join((ROOT / "docs" / "bibliography.md").read_text().split())
    cited = 0
    for file in SOURCE.rglob("*.py"):
        for block in re.findall(r"References?:\n((?:[ \t]+\S.*\n)+)", file.read_text()):
            sources = re.findall(r"(?:[A-Z]\.(?:-[A-Z]\.)? )+([A-Z]\w+)[^;]*?\((\d{4})\)", " ".join(block.split()))
            for name, year in sources:
                assert re.search(rf"{name}\b[^*]*\({year}\)", page), f"{name} ({year})"
                cited += 1
    assert cited > 15


def test_the_reference_has_every_public_name():
    """A function or class by its own directive, a module by itself or by one of its members."""
    page = (ROOT / "docs" / "reference.md").read_text()
    directives = re.findall(r"^::: (\S+)", page, re.MULTILINE)
    for name in dj.__all__:
        value = getattr(dj, name)
        if isinstance(value, ModuleType):
            assert any(directive.startswith(value.__name__) for directive in directives), name
        else:
            assert any(directive.rpartition(".")[2] == name for directive in directives), name


def navigation(entries):
    """Every page that the site's contents name."""
    for entry in entries:
        for value in entry.values():
            yield from navigation(value) if isinstance(value, list) else [value]


def test_every_actuator_is_on_the_models_page():
    page = (ROOT / "docs" / "model.md").read_text()
    assert [kind for kind in UNMODELLED if kind != "none" and f"| `{kind}` |" not in page] == []


def test_every_page_is_in_the_sites_contents():
    """The site is built without network by `make docs`, which is stricter: no warning."""
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    named = list(navigation(site["nav"]))
    assert len(named) == len(set(named))
    notebooks = {f"notebooks/{path.stem}.md" for path in NOTEBOOKS}
    assert set(named) == {page.name for page in (ROOT / "docs").glob("*.md")} | notebooks
    assert site["theme"]["font"] is False
    assert site["strict"] is True


@pytest.mark.long
def test_the_site_builds_without_warning(tmp_path):
    """And nothing in it is loaded from elsewhere; links of the theme to its makers are all there is."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    for page in tmp_path.glob("*.html"):
        text = page.read_text()
        assert not re.search(r"<(?:script|img|iframe)[^>]*src=\"(?:https?:)?//", text), page.name
        assert not re.search(r"<link[^>]*rel=\"(?:stylesheet|preconnect)\"[^>]*href=\"(?:https?:)?//", text), page.name
    for path in NOTEBOOKS:
        page = (tmp_path / "notebooks" / f"{path.stem}.html").read_text()
        assert page.count("data:image/png;base64,") == path.read_text().count('"image/png"')
    reference = (tmp_path / "reference.html").read_text()
    assert "dssc_jax.runs.run.run" in reference
    assert ":meth:" not in reference
