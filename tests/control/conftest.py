"""A run of the transport task whose windows hold up to three stages."""

import pytest

from psmpc_cli.control import Command

from ..solvers.recorded import responsive_transport
from ..stepped import stepped


@pytest.fixture(scope="session")
def decisions() -> list[Command]:
    """Every command of a PSMPC run of the transport task on a coarse mesh."""
    return stepped(responsive_transport()).commands
