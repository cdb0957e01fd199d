"""A walk through a document that may be wrong anywhere: what is not there is empty, not an error."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from psmpc_cli.specs.document import Data, Document
from psmpc_cli.specs.fields import number_or_angle
from psmpc_cli.specs.messages import Fault, Path

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Cursor:
    """One place of a document, whether there is a value or not."""

    document: Document
    path: Path = ()

    def __getitem__(self, step: str | int) -> "Cursor":
        return Cursor(self.document, (*self.path, step))

    @property
    def exists(self) -> bool:
        """Whether the document has a value here that is not null."""
        return self.value is not None

    @property
    def value(self) -> Data:
        """What is here, None if nothing."""
        return self.document.value(self.path) if self.path in self.document.entries else None

    @property
    def text(self) -> str | None:
        """The text here, None if there is none."""
        return self.value if isinstance(self.value, str) else None

    @property
    def number(self) -> float | None:
        """The number or angle [rad] here, None if there is none."""
        try:
            return number_or_angle(self.value)
        except ValueError:
            return None

    @property
    def length(self) -> int | None:
        """The length of the list here, None if there is none."""
        return len(self.value) if isinstance(self.value, list) else None

    @property
    def found(self) -> str:
        """What is here, in words."""
        return self.document.found(self.path)

    def items(self) -> Iterator[tuple[str, "Cursor"]]:
        """Give the keys and values of the mapping here."""
        yield from ((key, self[key]) for key in (self.value if isinstance(self.value, dict) else ()))

    def entries(self) -> Iterator["Cursor"]:
        """Give the entries of the list here; a text alone is a list of one."""
        if isinstance(self.value, str):
            yield self
        yield from (self[index] for index in range(self.length or 0))

    def valid(self, model: type[Model]) -> Model | None:
        """Return what is here as a model, its defaults if nothing is, None if it is not valid."""
        try:
            return model.model_validate({} if self.value is None else self.value)
        except ValidationError:
            return None

    def problem(self, message: str, at_key: bool = False) -> Fault:
        """Return a problem here."""
        return Fault(self.path, message, at_key=at_key)
