"""Every block of Python in the README and in docs/ runs by itself, every command line of ours is one that the program takes,
and the pages name all that can be called.

A block that cannot run says so in the source of its page, in the line before it: ``<!-- not run: reason -->``. Blocks run in a folder with
what a fresh checkout has, and nothing else. One that needs more says so there too, ``<!-- needs: flight.csv -->``, and the page before it
tells its readers.
"""

import ast
import importlib.util
import inspect
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from test_gap import HIDDEN, flight
from test_package import ENVIRONMENT

import propwash
from propwash import _gl

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<reason>[^\n]+?) -->\n+)?(?:^<!-- needs: (?P<needs>[^\n]+?) -->\n+)?^```(?P<language>\w+)\n(?P<code>.*?)^```$",
    re.S | re.M,
)
PEERS = ("crazyflow", "jax", "datasets", "webdataset", "ray", "gymnasium", "pettingzoo")
"""Packages without which a block is skipped, unless ``PROPWASH_REQUIRE_PEERS`` is 1."""
HEAVY = ("torch",)
"""Packages that are no part of the test environment: torch for Linux takes 3 GB."""
PLACEHOLDERS = ("…", "...")


def blocks(language):
    """Blocks of one language: page, number of the line, code, and why it cannot run."""
    found = []
    for page in PAGES:
        text = page.read_text()
        for block in BLOCK.finditer(text):
            if block["language"] == language:
                line = text.count("\n", 0, block.start("code")) + 1
                found.append((page.relative_to(ROOT).as_posix(), line, block["code"], block["reason"]))
    return found


def commands():
    """Command lines of the program, without comments: page, number of the line, words after ``propwash``."""
    found = []
    for page, line, code, reason in blocks("sh"):
        if reason is not None:
            continue
        for k, text in enumerate(code.splitlines()):
            whole, end = text, k
            while whole.rstrip().endswith("\\"):
                end += 1
                whole = whole.rstrip()[:-1] + " " + code.splitlines()[end]
            words = shlex.split(whole, comments=True)
            while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
                words.pop(0)
            if words[:2] == ["cargo", "run"] and "--" in words and "--example" not in words:
                words = ["propwash", *words[words.index("--") + 1 :]]
            if words and words[0].split("/")[-1] == "propwash":
                found.append((page, line + k, words[1:]))
    return found


PYTHON, COMMANDS = blocks("python"), commands()
NEEDS = {
    (page.relative_to(ROOT).as_posix(), text.count("\n", 0, block.start("code")) + 1): block["needs"]
    for page in PAGES
    for text in [page.read_text()]
    for block in BLOCK.finditer(text)
    if block["needs"] is not None
}
"""What blocks need beside the checkout, by page and line."""
NAMES = {}
"""What the blocks that ran have left, by page and line."""


def named(rows):
    return [pytest.param(*row, id=f"{row[0]}:{row[1]}") for row in rows]


@pytest.fixture(scope="session")
def extras(tmp_path_factory):
    """Makes what blocks need, once each, and gives its path."""
    folder = tmp_path_factory.mktemp("extras")

    def make(name):
        path = folder / name
        if path.exists():
            return path
        if name == "flight.csv":
            columns = flight(propwash.Vehicle("cf2x_L250").with_effects(HIDDEN))
            table = np.column_stack(list(columns.values()))
            np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
        elif name == "out/forest":
            fly_forest(folder)
        else:
            raise AssertionError(f"no block can need {name!r}: flight.csv or out/forest")
        return path

    return make


@pytest.fixture
def checkout(tmp_path):
    """A folder that has what a fresh checkout has, and takes what a block writes."""
    for name in ("assets", "benches", "docs", "examples", "notebooks", "params", "python", "src", "tests", "xml"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def test_blocks_and_commands_are_found():
    assert len(PYTHON) >= 12 and len(COMMANDS) >= 30
    assert {page for page, *_ in PYTHON} >= {"README.md", "docs/python.md", "docs/quickstart.md", "docs/migrate.md"}


@pytest.mark.parametrize("page, line, code, reason", named(PYTHON))
def test_examples_run(page, line, code, reason, checkout, extras, monkeypatch):
    if reason is not None and (reason != "needs OpenGL" or _gl.missing() is not None):
        ast.parse(code)
        pytest.skip(reason)
    for package in HEAVY if os.environ.get("PROPWASH_REQUIRE_PEERS") == "1" else (*PEERS, *HEAVY):
        if re.search(rf"^(?:import|from) {package}\b", code, re.M):
            pytest.importorskip(package)
    needs = NEEDS.get((page, line))
    if needs is not None:
        made = extras(needs)
        (checkout / needs).parent.mkdir(exist_ok=True)
        copy = shutil.copytree if made.is_dir() else shutil.copy
        copy(made, checkout / needs)
    monkeypatch.chdir(checkout)
    run(page, line, code)


@pytest.mark.parametrize("page, line", sorted(NEEDS))
def test_what_an_example_needs_is_said_before_it(page, line):
    before = "\n".join((ROOT / page).read_text().splitlines()[: line - 1])
    told = re.sub(r"<!--.*?-->", "", re.sub(r"^```\w+\n.*?^```$", "", before, flags=re.S | re.M), flags=re.S)
    assert re.search(rf"`[^`]*{re.escape(NEEDS[page, line])}[^`]*`", told), f"{page}:{line}: nothing says where {NEEDS[page, line]} is from"


def run(page, line, code):
    """Runs a block once and gives its names."""
    if (page, line) not in NAMES:
        names = {"__name__": "__main__"}
        exec(compile("\n" * (line - 1) + code, str(ROOT / page), "exec"), names)
        NAMES[page, line] = names
    return NAMES[page, line]


def fly_forest(folder):
    """The data set that the pages read, with fewer and smaller images."""
    program = os.environ.get("PROPWASH_BIN")
    if not program:
        pytest.skip("PROPWASH_BIN names no program that makes the data set out/forest")
    words = "fly --scene forest --drone cf2x_L250 --worlds 3 --seconds 0.5 --size 64x64 --out out/forest"
    command = [program, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page, line, words", named(COMMANDS))
def test_the_program_takes_the_command_lines(page, line, words):
    """Options and values are read, in order, before the help is asked for: an unknown one fails."""
    ours = words[:1] == ["evaluate"]  # which only the package of Python has
    program = [sys.executable, "-m", "propwash"] if ours else [os.environ.get("PROPWASH_BIN")]
    if not program[0]:
        pytest.skip("PROPWASH_BIN names no program")
    words = [w for w in words if w not in PLACEHOLDERS and not re.fullmatch(r"\[.*\]?|.*\]", w)]
    for stop in ("|", ">", "&&", ";"):
        words = words[: words.index(stop)] if stop in words else words
    done = subprocess.run([*program, *words, "--help"], capture_output=True, text=True, timeout=60, env=ENVIRONMENT)
    assert done.returncode == 0 and "usage: propwash" in done.stdout.lower(), f"{page}:{line}: {done.stdout}{done.stderr}"


def test_commands_of_xtask_in_the_pages_are_those_there_are():
    text = (ROOT / "xtask/src/main.rs").read_text()
    known = set(re.findall(r'Some\("([a-z]+)"', text))
    for page in PAGES:
        for name in re.findall(r"cargo xtask ([a-z]+)", page.read_text()):
            assert name in known, f"{page.name}: `cargo xtask {name}`; there are: {', '.join(sorted(known))}"


def test_both_programs_of_the_page_for_users_of_crazyflow_end_at_the_same_place():
    if os.environ.get("PROPWASH_REQUIRE_PEERS") != "1":
        pytest.importorskip("crazyflow")
    theirs, ours = [run(page, line, code)["sim"] for page, line, code, _ in PYTHON if page == "docs/migrate.md"][:2]
    there, here = np.asarray(theirs.data.states.pos), ours.data.pos
    assert there.shape == here.shape and np.abs(there - here).max() < 1e-3 and np.all(here[..., 2] > 0.4)


def test_physics_of_ones_own_does_in_both_what_the_page_for_users_of_crazyflow_says():
    if os.environ.get("PROPWASH_REQUIRE_PEERS") != "1":
        pytest.importorskip("crazyflow")
    lines, made = (ROOT / "docs/migrate.md").read_text().splitlines(), {}
    for page, line, code, _ in PYTHON:
        if page == "docs/migrate.md":
            headings = [text[4:] for text in lines[:line] if text.startswith("### ")]
            if headings:
                made.setdefault(headings[-1], []).append(run(page, line, code)["sim"])
    assert list(made) == ["A push at random", "Wind", "A force", "A controller", "Dynamics", "Masses at random"]
    theirs, *ours = made.pop("A push at random")
    there = np.std(theirs.data.states.vel[..., :2])
    for sim in ours:
        assert 0.7 < np.std(sim.data.vel[..., :2]) / there < 1.4 and there > 0.005
    theirs, ours = made.pop("Masses at random")
    for masses in np.asarray(theirs.data.params.mass)[..., 0], ours.parameter("body.mass_kg"):
        assert masses.shape == (64, 1) and np.all(abs(masses / 0.0328 - 1) <= 0.1001) and np.std(masses) > 0.001
    for heading, (theirs, *ours) in made.items():
        there = np.asarray(theirs.data.states.pos)
        assert np.abs(there).max() > 0.05, heading
        for sim in ours:
            assert np.abs(sim.data.pos - there).max() < 1e-4, heading


def test_the_page_of_commands_is_the_help_of_the_program():
    program = os.environ.get("PROPWASH_BIN")
    if not program:
        pytest.skip("PROPWASH_BIN names no program")
    spec = importlib.util.spec_from_file_location("make_commands", ROOT / "docs/make_commands.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    page = (ROOT / "docs/commands.md").read_text()
    assert made.page(os.path.abspath(program)) == page, f"run `python3 docs/make_commands.py {os.path.relpath(program, ROOT)}`"


SOURCES = sorted(path for folder in (ROOT / "src", *ROOT.glob("crates/*/src")) for path in folder.rglob("*.rs"))


def variants(path, name):
    """Variants of an enum of Rust, with the lines of attributes before each."""
    text = path.read_text()
    body = re.search(rf"^pub enum {name} \{{\n(.*?)^\}}", text, re.S | re.M)[1]
    found = re.finditer(r"((?:^    (?!pub |fn )[^A-Z\n][^\n]*\n)*?)^    ([A-Z]\w*)(?:,$| \{$|\()", body, re.M)
    return [(match[2], match[1]) for match in found]


def kebab(name):
    return re.sub(r"(?<!^)([A-Z])", r"-\1", name).lower()


def test_the_page_of_errors_has_every_error_of_the_library():
    page = (ROOT / "docs/errors.md").read_text()
    errors = []
    for path in SOURCES:
        for name in re.findall(r"^#\[derive\([^\n]*thiserror::Error\)\]\n(?:#[^\n]*\n)*pub enum (\w+)", path.read_text(), re.M):
            # Of byte code that the library makes itself; no user meets it.
            if name != "ProgramError":
                rows = variants(path, name)
                assert rows, f"{path}: no variant of {name} was read"
                errors += [f"{name}::{variant}" for variant, before in rows if "#[error(transparent)]" not in before]
    assert len(errors) >= 60
    missing = [error for error in [*errors, "EnvError::Failed"] if f"`{error}`" not in page]
    assert not missing, f"docs/errors.md has no row of {missing}"
    gone = set(re.findall(r"`(\w+Error::\w+|Error::\w+)`", page)) - set(errors) - {"EnvError::Failed"}
    assert not gone, f"docs/errors.md has rows of errors that are no more: {gone}"


@pytest.mark.parametrize(
    "heading, path, name, code",
    [
        ("Findings of the log checker", "check/mod.rs", "Fault", kebab),
        ("Parts of a log that are left out", "usable.rs", "Reason", kebab),
        ("Rules of a verdict", "decide/rules.rs", "Rule", lambda name: kebab(name).replace("-", "_")),
    ],
)
def test_the_page_of_errors_has_every_code(heading, path, name, code):
    (path,) = (file for file in SOURCES if file.as_posix().endswith(path) and f"pub enum {name} {{" in file.read_text())
    part = (ROOT / "docs/errors.md").read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    assert set(re.findall(r"^\| `([\w-]+)` \|", part, re.M)) == {code(name) for name, _ in variants(path, name)}


def test_the_page_of_errors_has_every_exception_and_warning_of_python():
    page = (ROOT / "docs/errors.md").read_text()
    for path in sorted((ROOT / "python/propwash").rglob("*.py")):
        for name in re.findall(r"^class (\w+(?:Error|Warning))\(", path.read_text(), re.M):
            assert re.search(rf"`(?:propwash\.datasets\.)?{name}`", page), f"{path.name}: docs/errors.md does not say what {name} is"


def test_the_page_of_examples_has_every_example():
    page = (ROOT / "docs/examples.md").read_text()
    made = [*(ROOT / "examples").iterdir(), *(ROOT / "notebooks").glob("*.ipynb")]
    missing = [path.name for path in made if path.suffix in (".rs", ".py", ".ipynb") and f"{path.name})" not in page]
    assert not missing, f"docs/examples.md has no row of {missing}"


def test_every_effect_has_its_picture():
    for page in sorted((ROOT / "docs/effects").glob("*.md")):
        if page.stem not in ("README", "expression", "disturbance"):
            assert f"]({page.stem}.png)" in page.read_text(), f"{page.name}: run docs/make_effect_pictures.py {page.stem}"
            assert 1000 < page.with_suffix(".png").stat().st_size < 60_000


def test_the_glossary_is_in_order():
    terms = re.findall(r"^- \*\*(.+?)\*\*: ", (ROOT / "docs/glossary.md").read_text(), re.M)
    words = [re.sub(r"[^\w ,-]", "", term).lower() for term in terms]
    assert len(words) > 100 and words == sorted(words)


def test_the_api_pages_name_all_that_the_package_gives():
    pages = "\n".join(page.read_text() for page in (ROOT / "docs").glob("api*.md"))
    told = set(re.findall(r"^::: propwash\.(\w+)$", pages, re.M))
    assert set(propwash.__all__) - {"__version__"} <= told


def test_tests_that_pages_name_are_there():
    named = [(page, *name) for page in PAGES for name in re.findall(r"`([\w./-]+\.(?:rs|py))::(\w+)`", page.read_text())]
    assert len([page for page, *_ in named if page.name == "reviews.md"]) > 80
    for page, path, name in named:
        file = ROOT / path
        assert file.is_file(), f"{page.name} names {path}, which is not there"
        test = rf"#\[test\]\n(?:\s*(?:#\[.*\]|//.*)\n)*\s*fn {name}\b" if file.suffix == ".rs" else rf"^def {name}\b"
        assert re.search(test, file.read_text(), re.M), f"{page.name} names {name}, which is no test of {path}"


def test_every_page_is_in_the_navigation():
    """mkdocs says so too, when the site is built."""
    navigation = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")[1]
    for page in PAGES[1:]:
        path = page.relative_to(ROOT / "docs").as_posix()
        assert path.startswith("effects/") or re.search(rf": {re.escape(path)}$", navigation, re.M), f"{path} is in no menu"


def test_the_docstrings_of_the_stub_are_those_of_the_compiled_module():
    """Editors and the API page read the stub; `help()` reads the module."""
    stub = ast.parse((Path(propwash.__file__).parent / "_native.pyi").read_text())
    names = {name for name in propwash.__all__ if getattr(propwash._native, name, None) is getattr(propwash, name)}
    public = [node for node in stub.body if getattr(node, "name", None) in names]
    assert len(public) >= 6
    for node in public:
        thing = getattr(propwash, node.name)
        assert ast.get_docstring(node) == inspect.cleandoc(thing.__doc__), node.name
        for member in getattr(node, "body", []):
            if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
                words = getattr(thing, member.name).__doc__
                assert (ast.get_docstring(member) or "") == inspect.cleandoc(words or ""), f"{node.name}.{member.name}"


def test_nothing_of_the_site_comes_from_other_hosts():
    text = (ROOT / "mkdocs.yml").read_text()
    assert re.search(r"^  font: false$", text, re.M) and "http" not in text
    for path in (ROOT / "docs/site").iterdir():
        assert not re.search(r"(url\(|@import|src=|href=)", path.read_text()), path.name
