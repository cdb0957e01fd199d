"""Pydantic's validation errors as problems: at the path in the file, with what was found and what was expected."""

from collections.abc import Callable, Iterator
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from psmpc_cli.specs.annotations import Location, keys_at, length_at, meaning_at
from psmpc_cli.specs.document import Document
from psmpc_cli.specs.fields import EXPECTED
from psmpc_cli.specs.messages import Fault, Path, choice, counted, suggestion


def complain(error: ValidationError, document: Document, model: type[BaseModel]) -> Iterator[Fault]:
    """Give every error of a validation as a problem of the document; a misspelt key is not also a missing one."""
    details = error.errors(include_url=False)
    misspelt = {key for detail in details if detail["type"] == "extra_forbidden" for key in _meant(detail, model)}
    for detail in details:
        if detail["type"] == "extra_forbidden":
            yield _unknown_key(detail, document, model)
        elif detail["type"] == "missing" and isinstance(detail["loc"][-1], str):
            if detail["loc"] not in misspelt:
                yield _missing_key(detail, document, model)
        elif not _half_counted(detail):
            yield _wrong_value(detail, document, model)


def locate(document: Document, location: Location) -> Path:
    """Return the path in the document of a location, which also names branches and what was normalized."""
    path: Path = ()
    for step in location:
        if (*path, step) in document.entries:
            path = (*path, step)
    return path


def _meant(detail: ErrorDetails, model: type[BaseModel]) -> Iterator[Location]:
    """Give the location of the key that an unknown one may stand for."""
    *around, key = detail["loc"]
    near = suggestion(str(key), keys_at(model, tuple(around)))
    if near is not None:
        yield (*around, near)


def _half_counted(detail: ErrorDetails) -> bool:
    """Tell whether a list is only too short because its wrong entries do not count."""
    return detail["type"] == "too_short" and len(detail["input"]) >= detail["ctx"]["min_length"]


def _unknown_key(detail: ErrorDetails, document: Document, model: type[BaseModel]) -> Fault:
    key = str(detail["loc"][-1])
    expected = choice(key, keys_at(model, detail["loc"][:-1]))
    return Fault(locate(document, detail["loc"]), f"found an unknown key{expected}", at_key=True)


def _missing_key(detail: ErrorDetails, document: Document, model: type[BaseModel]) -> Fault:
    path = locate(document, detail["loc"])
    meaning = meaning_at(model, detail["loc"])
    return Fault(path, f'found no key "{detail["loc"][-1]}", expected {meaning}', at_key=True)


def _wrong_value(detail: ErrorDetails, document: Document, model: type[BaseModel]) -> Fault:
    path = locate(document, detail["loc"])
    if detail["type"] == "literal_error":
        options = str(detail["ctx"]["expected"]).replace("'", "").replace(" or ", ", ").split(", ")
        return Fault(path, f"found {document.found(path)}{choice(str(document.value(path)), options)}")
    return Fault(path, f"found {document.found(path)}, expected {_expected(detail, model)}")


def _expected(detail: ErrorDetails, model: type[BaseModel]) -> str:
    """Say what a value should have been."""
    if detail["type"] == "missing":
        return counted(length_at(model, detail["loc"][:-1]), "entry", "entries")
    if detail["type"] in ("model_type", "model_attributes_type"):
        return f"a mapping with the keys {', '.join(keys_at(model, detail['loc']))}"
    if detail["type"] in ("dict_type", "mapping_type"):
        return f"a mapping ({meaning_at(model, detail['loc'])})"
    wording = _WORDINGS.get(detail["type"])
    return wording(detail.get("ctx", {})) if wording else detail["msg"]


_WORDINGS: dict[str, Callable[[dict[str, Any]], str]] = {
    EXPECTED: lambda context: str(context["what"]),
    "string_type": lambda context: "a text (in quotes if it looks like a number)",
    "bool_type": lambda context: "true or false",
    "tuple_type": lambda context: "a list",
    "greater_than": lambda context: f"a number greater than {context['gt']:g}",
    "greater_than_equal": lambda context: f"a number of at least {context['ge']:g}",
    "less_than": lambda context: f"a number less than {context['lt']:g}",
    "less_than_equal": lambda context: f"a number of at most {context['le']:g}",
    "too_short": lambda context: f"at least {counted(context['min_length'], 'entry', 'entries')}",
    "too_long": lambda context: counted(context["max_length"], "entry", "entries"),
    "string_too_short": lambda context: "a text that is not empty",
}
