"""Problems as text: `file:line:column: path: what was found, what was expected`, and the line itself."""

from collections.abc import Iterable, Sequence

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import Document
from psmpc_cli.specs.problem import Place, Problem, dotted

MOST_PROBLEMS = 50
"""Problems of one file that a report writes out."""

WIDEST = 120
"""Columns of a source line that a report repeats."""


def report(document: Document, problems: Iterable[Problem]) -> str:
    """Write all problems of a document, in the order of its lines, those of the command line last."""
    ordered = sorted(dict.fromkeys(problems), key=lambda problem: _order(document, problem))
    lines = [render(document, problem) for problem in ordered[:MOST_PROBLEMS]]
    if len(ordered) > MOST_PROBLEMS:
        lines.append(f"{document.name}: {len(ordered) - MOST_PROBLEMS} more problems")
    return "\n".join(lines)


def render(document: Document, problem: Problem) -> str:
    """Write one problem with the line of the file it is about."""
    what = f"{dotted(problem.path)}: {problem.message}" if problem.path else problem.message
    override = document.entry(problem.path).override
    if override is not None:
        return f"{override}: {what}"
    place = _place(document, problem)
    head = f"{document.name}:{place.line}:{place.column}: {what}"
    source = _source(document.text, place)
    return f"{head}\n{source}" if source else head


def refusal(*reports: str) -> SpecError:
    """Return one error that says what all reports say; empty ones say nothing."""
    return SpecError("\n".join(text for text in reports if text))


def _place(document: Document, problem: Problem) -> Place:
    """Return where a problem is."""
    if problem.at is not None:
        return problem.at
    entry = document.entry(problem.path)
    return entry.key if problem.aims_at_key and entry.key is not None else entry.place


def _order(document: Document, problem: Problem) -> tuple[bool, int, int]:
    """Return what to sort a problem by."""
    place = _place(document, problem)
    return document.entry(problem.path).override is not None, place.line, place.column


def _source(text: str, place: Place) -> str:
    """Write the line of a place with a caret under its column; nothing for a line that is not there."""
    lines: Sequence[str] = text.splitlines()
    if place.line > len(lines) or not lines[place.line - 1].strip():
        return ""
    line = lines[place.line - 1]
    start = max(0, place.column - WIDEST // 2) if len(line) > WIDEST else 0
    shown = "".join(c if c.isprintable() or c == "\t" else "?" for c in line[start : start + WIDEST]).rstrip()
    pad = "".join("\t" if c == "\t" else " " for c in shown[: place.column - 1 - start])
    margin = f"{place.line:>4} | "
    return f"{margin}{shown}\n{' ' * (len(margin) - 2)}| {pad.ljust(place.column - 1 - start)}^"
