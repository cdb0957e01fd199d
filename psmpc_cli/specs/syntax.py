"""PyYAML's syntax errors in words for people who write YAML, not parsers."""

import re
from collections.abc import Callable

from yaml.error import Mark, MarkedYAMLError

from psmpc_cli.specs.problem import Place, Problem

Wording = Callable[[re.Match[str], MarkedYAMLError], Problem]

_TOKENS = {
    "<stream end>": "the end of the file",
    "<block end>": "the end of the block",
    "<block mapping start>": "a line indented differently",
    "<block sequence start>": "a list",
    "<scalar>": "a word",
    "?": "a key",
    "-": 'an entry "- "',
    "<alias>": "an alias",
    "<anchor>": "an anchor",
    "<tag>": "a tag",
}


def explain(error: MarkedYAMLError) -> Problem:
    """Return a syntax error as what was found and expected, where."""
    for pattern, wording in _WORDINGS:
        match = re.search(pattern, " ".join(part for part in (error.context, error.problem) if part))
        if match:
            return wording(match, error)
    context = (
        f" ({error.context} in line {error.context_mark.line + 1})" if error.context and error.context_mark else ""
    )
    return _at(error.problem_mark, f"found no valid YAML, {error.problem}{context}")


def _at(mark: Mark | None, message: str) -> Problem:
    """Return a problem of the whole file at a mark of PyYAML."""
    return Problem((), message, None if mark is None else Place(mark.line + 1, mark.column + 1))


def _token(name: str) -> str:
    """Name a token of PyYAML's parser."""
    return _TOKENS.get(name, f'"{name}"')


def _started(error: MarkedYAMLError) -> str:
    """Say in which line the construct began that an error is about."""
    return f"line {error.context_mark.line + 1}" if error.context_mark else "its first line"


def _stray_colon(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(
        error.problem_mark,
        'found ":" where no key can stand, expected one "key: value" a line, indented like its neighbours '
        '(and a space after ":")',
    )


def _tab(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(error.problem_mark, "found a tab, expected spaces")


def _reserved(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(error.problem_mark, f'found "{match[1]}" at the start of a word, expected the word in quotes')


def _unclosed_flow(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    ends = match[2] == "<stream end>"
    kind = {"]": "list", "}": "mapping"}[match[1]]
    return _at(
        error.context_mark if ends else error.problem_mark,
        f'found {_token(match[2])}, expected "," or "{match[1]}" in the {kind} that starts in {_started(error)}',
    )


def _block(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    kind = {"collection": "list", "mapping": "mapping"}[match[1]]
    return _at(
        error.problem_mark,
        f"found {_token(match[2])}, expected the {kind} that starts in {_started(error)} to go on or to end "
        "(is it indented like its neighbours?)",
    )


def _no_colon(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(error.context_mark, 'found a word alone, expected "key: value"')


def _open_quote(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(error.context_mark, "found a quote that is never closed, expected a second one")


def _unknown_alias(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(error.problem_mark, f"found the alias *{match[1]}, expected an anchor &{match[1]} before it")


def _anchor_again(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(
        error.problem_mark,
        f"found the anchor &{match[1]} again (first in {_started(error)}), expected every anchor once",
    )


def _second_document(match: re.Match[str], error: MarkedYAMLError) -> Problem:
    return _at(
        error.problem_mark, 'found more after the end of the document, expected one document (no "---" or "...")'
    )


_WORDINGS: tuple[tuple[str, Wording], ...] = (
    (r"mapping values are not allowed here", _stray_colon),
    (r"found character '\\t'", _tab),
    (r"found character '(.)' that cannot start any token", _reserved),
    (r"expected ',' or '([\]}])', but got '(.+)'", _unclosed_flow),
    (r"while parsing a block (collection|mapping) expected <block end>, but found '(.+)'", _block),
    (r"could not find expected ':'", _no_colon),
    (r"quoted scalar found unexpected end of stream", _open_quote),
    (r"found undefined alias '(.+)'", _unknown_alias),
    (r"found duplicate anchor '(.+)'", _anchor_again),
    (r"expected a single document|expected '<document start>'", _second_document),
)
