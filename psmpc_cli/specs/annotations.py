"""What the models say about a place: which keys it knows, how long its list is, what it means."""

from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag

Location = tuple[str | int, ...]
"""Pydantic's way to a value: keys, indices, and names of the branches of a union."""


def keys_at(model: type[BaseModel], location: Location) -> tuple[str, ...]:
    """Return the keys that the mapping at a location knows; none if it takes any."""
    kind = _at(model, location)
    return tuple(kind.model_fields) if _is_model(kind) else ()


def length_at(model: type[BaseModel], location: Location) -> int:
    """Return the length of the list of fixed length at a location."""
    return len(get_args(_at(model, location)))


def meaning_at(model: type[BaseModel], location: Location) -> str:
    """Return what the field at a location means."""
    owner = _at(model, location[:-1])
    if get_origin(owner) in (Union, UnionType):
        return meaning_at(model, location[:-1])
    field = owner.model_fields.get(location[-1]) if _is_model(owner) else None
    return (field.description if field else None) or "this key"


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _at(model: type[BaseModel], location: Location) -> Any:
    """Return the annotation at a location, without what only decorates it."""
    kind: Any = model
    for step in location:
        kind = _plain(_inside(kind, step))
    return kind


def _plain(kind: Any) -> Any:
    """Return an annotation without `Annotated` and without `None` as an alternative."""
    if get_origin(kind) is Annotated:
        return _plain(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        others = [option for option in get_args(kind) if option is not NoneType]
        return _plain(others[0]) if len(others) == 1 else kind
    return kind


def _inside(kind: Any, step: str | int) -> Any:
    """Return the annotation one step inside; the name of a union's branch leads to that branch."""
    if _is_model(kind):
        field = kind.model_fields.get(step)
        return field.annotation if field else kind
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return next((option for option in arguments if Tag(str(step)) in getattr(option, "__metadata__", ())), kind)
    if origin is tuple and isinstance(step, int):
        return arguments[0] if Ellipsis in arguments else arguments[step]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return arguments[1]
    return kind
