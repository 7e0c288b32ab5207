"""What mkdocs does not do by itself for the site of the documentation.

- Files that pages link to outside of docs/ (code, scenes, vehicles) get pages of their own under ``source/``, so that the same
  relative link works in the checkout and in the site. Links that are called by a file's name get the page's title.
- ``effects/`` in the navigation becomes all pages of that folder, with a generated list as the first.
- Notebooks of notebooks/ become pages, with their outputs as they are checked in.
- Equations become MathML, which browsers draw without a script; symbols in sentences of the effects' pages get real subscripts.
"""

from __future__ import annotations

import html
import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
NOTEBOOKS = ROOT / "notebooks"

LINK = re.compile(r"(?<=\]\()(\.\.?/[^)\s#]*|[^)\s#:/]+/)(?=[)#])")
"""Targets that may lead out of docs/ or to a folder."""

TITLED = re.compile(r"\[([\w/.-]+\.md)\]\(([^)\s#]+\.md)(?=[)#])")
"""Links that are called by the name of their file."""

SYMBOL = re.compile(r"(?<![\w`])([A-Za-zα-ωΑ-Ω])_([a-z]{1,7})(?![\w`])")
"""A symbol with a subscript, as pages write it in sentences: `p_i`, `Ω_max`."""

NOT_WORDS = re.compile(r"(^```.*?^```$|\$\$.*?\$\$|`[^`\n]*`)", re.S | re.M)
"""Blocks, equations and code, in which underscores stay."""

LANGUAGES = {".rs": "rust", ".py": "python", ".toml": "toml", ".xml": "xml", ".sh": "bash", ".txt": "text", ".rhai": "text"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Puts the pages of the effects into the navigation."""

    def filled(entry: Any) -> Any:
        if isinstance(entry, dict):
            return {title: filled(value) for title, value in entry.items()}
        if isinstance(entry, list):
            return [filled(value) for value in entry]
        if entry == "effects/":
            return ["effects/README.md", *(f"effects/{path.name}" for path in _effects())]
        return entry

    config.nav = filled(config.nav)
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds what lies outside of docs/, and the list of effects."""
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        text, resources = MarkdownExporter().from_filename(str(path))
        for name, picture in resources["outputs"].items():
            files.append(File.generated(config, f"notebooks/{path.stem}/{name}", content=picture))
            text = text.replace(f"({name})", f"({path.stem}/{name})")
        # Tables of pandas look like those of the pages.
        text = text.replace('<table border="1" class="dataframe">', "<table>")
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
    files.append(File.generated(config, "effects/README.md", content=_list_of_effects()))
    wanted: set[str] = set()
    for path in sorted(DOCS.rglob("*.md")):
        for target in LINK.findall(path.read_text(encoding="utf-8")):
            wanted.add(_meant(path.relative_to(ROOT).as_posix(), target))
    for target in sorted(wanted):
        for name in (target, *_listed(target)):
            to = _in_site(name)
            if to.startswith("source/") and files.get_file_from_path(to) is None:
                files.append(File.generated(config, to, content=_source_page(name), inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Leads links out of docs/ and to folders to where that is in the site, and calls pages by their titles."""
    here = page.file.src_uri
    if here.startswith("source/"):
        return markdown
    lies = here.removesuffix(".md") + ".ipynb" if here.startswith("notebooks/") else f"docs/{here}"

    def led(match: re.Match[str]) -> str:
        return posixpath.relpath(_in_site(_meant(lies, match.group(1))), posixpath.dirname(here) or ".")

    def titled(match: re.Match[str]) -> str:
        target = match.group(2)
        path = DOCS / posixpath.normpath(posixpath.join(posixpath.dirname(here), target))
        return f"[{_title(path) if path.is_file() else match.group(1)}]({target}"

    # `rust,ignore` and `toml-part` are words to the tests of these blocks.
    markdown = re.sub(r"^```(\w+)[,-]\w+$", r"```\1", markdown, flags=re.M)
    # Lines of Rust that only its tests need begin with `# `, as in rustdoc.
    markdown = re.sub(
        r"^```rust$.*?^```$", lambda block: re.sub(r"^#(?: .*)?\n", "", block.group(), flags=re.M), markdown, flags=re.S | re.M
    )
    if here.startswith("effects/"):
        parts = NOT_WORDS.split(markdown)
        parts[::2] = [SYMBOL.sub(r"\1<sub>\2</sub>", words) for words in parts[::2]]
        markdown = "".join(parts)
    return TITLED.sub(titled, LINK.sub(led, markdown))


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns equations into MathML. Columns without a name have no heading that is empty."""
    content = re.sub(r"<th([^>]*)></th>", r"<td\1></td>", content)

    def drawn(match: re.Match[str]) -> str:
        return convert(html.unescape(match.group(1)), display="block")

    return re.sub(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', drawn, content, flags=re.S)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Gives the search of the theme a name."""
    return output.replace('data-md-component="search" role="dialog"', 'data-md-component="search" role="dialog" aria-label="Search"')


def _effects() -> list[Path]:
    return [path for path in sorted((DOCS / "effects").glob("*.md")) if path.stem != "README"]


def _list_of_effects() -> str:
    rows = ["# Effects", "", "What a vehicle file may list, one page each.", ""]
    rows += [
        "The pictures of the pages are made by `docs/make_effect_pictures.py`. An independent simulator flies a vehicle with the effect; "
        "orange is what a model without it lacks, blue what is left once `propwash add` has written the effect into the vehicle file. "
        "That vehicle is also off by its manufacturing tolerances, so blue is not zero everywhere.",
        "",
    ]
    rows += ["| effect | key | what it models |", "| --- | --- | --- |"]
    for path in _effects():
        text = path.read_text(encoding="utf-8")
        title = _title(path)
        words = " ".join(text.split("## What it models", 1)[1].split("\n\n", 2)[1].split())
        sentence = re.split(r"(?<=[.:])\s", words, maxsplit=1)[0].rstrip(".:")
        rows.append(f"| [{title}]({path.name}) | `{path.stem}` | {sentence} |")
    return "\n".join(rows) + "\n"


def _title(path: Path) -> str:
    return path.read_text(encoding="utf-8").split("\n", 1)[0].removeprefix("# ")


def _meant(page: str, target: str) -> str:
    """What a link means, from the root of the checkout."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(page), target))
    if path.startswith("..") or not (ROOT / path).exists():
        raise PluginError(f"{page}: the link `{target}` leads to {path}, which is not in the checkout")
    return path


def _in_site(path: str) -> str:
    """The page of the site that shows a file or folder of the checkout."""
    if path.startswith("docs/"):
        inside = path.removeprefix("docs/")
        return f"{inside}/README.md" if (ROOT / path).is_dir() else inside
    if path.startswith("notebooks/") and path.endswith(".ipynb"):
        return path.removesuffix(".ipynb") + ".md"
    return f"source/{path}.md"


def _listed(folder: str) -> list[str]:
    """Files of a folder, from the root of the checkout; none for a file."""
    if not (ROOT / folder).is_dir():
        return []
    return [f"{folder}/{path.name}" for path in sorted((ROOT / folder).iterdir()) if path.suffix in LANGUAGES]


def _source_page(name: str) -> str:
    path = ROOT / name
    head = f"---\ntitle: {path.name}\nsearch:\n  exclude: true\nhide: [toc, navigation]\n---\n\n# `{name}`\n\n"
    if path.is_dir():
        rows = [f"- [`{Path(f).name}`]({posixpath.basename(name)}/{Path(f).name}.md) {_about(ROOT / f)}" for f in _listed(name)]
        return head + "\n".join(rows) + "\n"
    text = path.read_text(encoding="utf-8")
    fence = "`" * max([3, *(len(run) + 1 for run in re.findall(r"`{3,}", text))])
    return f"{head}{fence} {{.{LANGUAGES.get(path.suffix, 'text')} linenums=\"1\"}}\n{text.rstrip()}\n{fence}\n"


def _about(path: Path) -> str:
    """The first sentence of a file's own description."""
    words = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.removeprefix("//!").strip() or not line.startswith("//!"):
            break
        words.append(line.removeprefix("//!").strip())
    return re.split(r"(?<=\.)\s", " ".join(words), maxsplit=1)[0]
