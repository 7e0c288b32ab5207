"""Writes docs/commands.md, the help of every command, by asking the program itself.

    python3 docs/make_commands.py target/debug/propwash            # write the page
    python3 docs/make_commands.py --check target/debug/propwash    # only compare; exit code 1 when the page is stale

Standard library only. ``python/tests/test_docs.py`` compares too.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parent / "commands.md"

HEAD = """\
# Commands

The help of every command of the program `propwash`, as `propwash COMMAND --help` prints it. This page is written by
`python3 docs/make_commands.py target/debug/propwash`; a test fails when it is out of date.

Exit codes are the same everywhere: 0 fine, 1 a check found a problem, 2 error ([errors.md](errors.md#exit-codes)).
"""


def page(program: str) -> str:
    """The page, for a program with this path."""
    helps = dict(_walk(program, []))
    rows = ["| command | what it does |", "| --- | --- |"]
    parts = []
    for words, text in helps.items():
        title = " ".join(["propwash", *words])
        anchor = re.sub(r"[^\w-]", "", title.lower().replace(" ", "-"))
        about = " ".join(text.split("\n\n")[0].split())
        if words and not _inner(text):
            rows.append(f"| [`{title}`](#{anchor}) | {about} |")
        parts += [f"## {title}", "", "```text", text.rstrip(), "```", ""]
    return "\n".join([HEAD, *rows, "", *parts]).rstrip() + "\n"


def _walk(program: str, words: list[str]):
    text = _help(program, words)
    yield tuple(words), text
    for name in _inner(text):
        yield from _walk(program, [*words, name])


def _inner(text: str) -> list[str]:
    """Names of the commands that a help lists."""
    listed = re.search(r"^Commands:\n((?:  .*\n)+)", text, re.M)
    names = re.findall(r"^  (\S+)  ", listed[1], re.M) if listed else []
    return [name for name in names if name != "help"]


def _help(program: str, words: list[str]) -> str:
    # As wide as on a terminal of 100 columns, whatever this one has.
    environment = {**os.environ, "COLUMNS": "100"}
    done = subprocess.run(
        [program, *words, "--help"], stdin=subprocess.DEVNULL, capture_output=True, text=True, env=environment, check=True
    )
    return "\n".join(line.rstrip() for line in done.stdout.splitlines())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="path of the program, such as target/debug/propwash")
    parser.add_argument("--check", action="store_true", help="only compare")
    args = parser.parse_args()
    text = page(os.path.abspath(args.program))
    if not args.check:
        PAGE.write_text(text, encoding="utf-8")
    elif text != PAGE.read_text(encoding="utf-8"):
        print(f"{PAGE.name} is out of date: run python3 docs/make_commands.py {args.program}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
