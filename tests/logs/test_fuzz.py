"""Whatever is done to a log, it is read or refused in one message, soon, and stays as it is."""

from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import LogError
from psmpc_cli.logs.comparison import merge_logs, read_comparison
from psmpc_cli.logs.read import read_log
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.schema import PARETO, SWEEP
from psmpc_cli.logs.seal import unseal
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.studies.monte_carlo import read_monte_carlo

from ..fuzzing import fuzzing
from ..made_up_fronts import made_up_fronts
from ..made_up_monte_carlo import made_up_monte_carlo
from ..made_up_sweep import made_up_sweep
from ..mutated_files import mutated_bytes, mutated_file
from .records import HEADER, LEAN, record

READERS = {
    "log": read_log,
    "comparison": read_comparison,
    "sweep": lambda path: read_results(path, SWEEP),
    "fronts": lambda path: read_results(path, PARETO),
    "runs": read_monte_carlo,
}


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A file of every kind as it stands when it is complete."""
    folder = tmp_path_factory.mktemp("whole")
    for name, header in (("log", HEADER), ("lean", LEAN)):
        with LogWriter(folder / name, header) as log:
            for k in range(3):
                log.write(record(k))
            log.finish(True, "done", {"final/end_time": 0.3})
    merge_logs({"one": folder / "log", "two": folder / "lean"}, folder / "comparison")
    made_up_sweep(folder / "sweep", "3x3")
    made_up_fronts(folder / "fronts")
    made_up_monte_carlo(folder / "runs")
    return {name: (folder / name).read_bytes() for name in READERS}


def is_read_or_refused(kind: str, path: Path) -> bool:
    before = path.read_bytes()
    try:
        READERS[kind](path)
    except LogError as error:
        assert str(error).startswith(f"{path}: ")
        assert str(error).isprintable() and len(str(error)) < 1000
    return path.read_bytes() == before


@pytest.mark.parametrize("kind", READERS)
@fuzzing(100)
@given(seed=st.integers(0, 2**32), sealed=st.booleans())
def test_damaged_bytes_are_read_or_refused(
    tmp_path: Path, contents: dict[str, bytes], kind: str, seed: int, sealed: bool
) -> None:
    path, random = tmp_path / "damaged.h5", Random(seed)
    path.write_bytes(contents[kind])
    if not sealed:
        unseal(path)
    path.write_bytes(mutated_bytes(path.read_bytes(), random))
    assert is_read_or_refused(kind, path)


@pytest.mark.parametrize("kind", READERS)
@fuzzing(100)
@given(seed=st.integers(0, 2**32))
def test_what_a_stranger_makes_of_a_file_is_read_or_refused(
    tmp_path: Path, contents: dict[str, bytes], kind: str, seed: int
) -> None:
    path = tmp_path / "strange.h5"
    path.write_bytes(contents[kind])
    mutated_file(path, Random(seed))
    assert is_read_or_refused(kind, path)
