"""How the source reads, in numbers: `python -m benchmarks.house [folder]`."""

import argparse
import ast
import io
import tokenize
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

WIDTH = 100  # columns
_COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_BLANK = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)
_HEAD = "lines  code  logical  comments  compr./100  wide %  longest function"


class Longest(NamedTuple):
    """The longest of something."""

    lines: int
    name: str


@dataclass(frozen=True)
class Figures:
    """What is counted in a file, or in several.

    Attributes:
        lines: all of them.
        code: lines without docstrings, comments and blanks.
        logical: statements that end a line; docstrings are none.
        comments: comments, beside code too.
        comprehensions: list, set and dict comprehensions, and generators.
        wide: lines beyond 100 columns.
        function: the longest, in lines of code of its body.
        file: the longest, in lines.
    """

    lines: int
    code: int
    logical: int
    comments: int
    comprehensions: int
    wide: int
    function: Longest
    file: Longest

    def __add__(self, other: "Figures") -> "Figures":
        return Figures(
            lines=self.lines + other.lines,
            code=self.code + other.code,
            logical=self.logical + other.logical,
            comments=self.comments + other.comments,
            comprehensions=self.comprehensions + other.comprehensions,
            wide=self.wide + other.wide,
            function=max(self.function, other.function),
            file=max(self.file, other.file),
        )

    @property
    def per_hundred(self) -> float:
        """Comprehensions per 100 lines of code."""
        return 100 * self.comprehensions / max(self.code, 1)

    @property
    def wide_share(self) -> float:
        """Percent of the lines beyond 100 columns."""
        return 100 * self.wide / max(self.lines, 1)


def figures(path: Path) -> Figures:
    """The figures of a Python file, or of all in a folder and below.

    Raises:
        OSError: if there is no such file.
        ValueError: if a folder holds no Python file.
    """
    if not path.is_dir():
        return _of_source(path.read_text(), str(path))
    files = sorted(path.rglob("*.py"))
    if not files:
        raise ValueError(f"path: {path} holds no Python file")
    first, *others = (figures(file) for file in files)
    for other in others:
        first += other
    return first


def _of_source(text: str, name: str) -> Figures:
    nodes = list(ast.walk(ast.parse(text)))
    documents = [node for node in nodes if _is_document(node)]
    documented: set[int] = set()
    for node in documents:
        documented.update(_lines(node))
    code: set[int] = set()
    statements = comments = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        statements += token.type == tokenize.NEWLINE
        comments += token.type == tokenize.COMMENT
        if token.type not in _BLANK:
            code.update(range(token.start[0], token.end[0] + 1))
    code -= documented
    longest = Longest(0, "")
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = range(node.body[0].lineno, _last(node) + 1)
            lines = len(code.intersection(body))
            longest = max(longest, Longest(lines, f"{node.name} ({name})"))
    lines = text.splitlines()
    return Figures(
        lines=len(lines),
        code=len(code),
        logical=statements - len(documents),
        comments=comments,
        comprehensions=sum(isinstance(node, _COMPREHENSIONS) for node in nodes),
        wide=sum(len(line) > WIDTH for line in lines),
        function=longest,
        file=Longest(len(lines), name),
    )


def _is_document(node: ast.AST) -> bool:
    """Whether it is a string that stands alone: a docstring, of a constant too."""
    alone = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return alone and isinstance(node.value.value, str)


def _lines(node: ast.stmt) -> range:
    return range(node.lineno, _last(node) + 1)


def _last(node: ast.stmt) -> int:
    return node.end_lineno or node.lineno


def _row(found: Figures) -> str:
    counts = f"{found.lines:5}  {found.code:4}  {found.logical:7}  {found.comments:8}"
    shares = f"{found.per_hundred:10.1f}  {found.wide_share:6.2f}"
    name, _, _ = found.function.name.partition(" (")
    return f"{counts}  {shares}  {found.function.lines:3} {name}"


def main() -> None:
    """Print the figures of every file of a folder, and their sum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default="uwaug", type=Path, help="uwaug by default")
    folder = parser.parse_args().folder
    files = sorted(folder.rglob("*.py"))
    if not files:
        parser.error(f"{folder} holds no Python file")
    wide = max(len(str(file)) for file in files)
    print(" " * wide, _HEAD)
    for file in files:
        print(str(file).ljust(wide), _row(figures(file)))
    total = figures(folder)
    print("in sum".ljust(wide), _row(total))
    print(f"longest function: {total.function.lines} lines, {total.function.name}")
    print(f"longest file: {total.file.lines} lines, {total.file.name}")


if __name__ == "__main__":
    main()
