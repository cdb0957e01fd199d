"""What a file is, by its kind."""

import shutil
from pathlib import Path

import h5py
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.schema import COMPARISON, RUN


def test_the_kind_tells_files_apart(merged: Path, logs: dict[str, Path], tmp_path: Path) -> None:
    unsaid = Path(shutil.copy(logs["hard"], tmp_path / "unsaid.h5"))
    with h5py.File(unsaid, "r+") as file:
        del file.attrs["kind"]
    assert [kind_of(path) for path in (merged, logs["hard"], unsaid)] == [COMPARISON, RUN, RUN]
    with pytest.raises(LogError, match="found a comparison, expected a log"):
        read_run(merged)
    with pytest.raises(LogError, match="found a run, expected a comparison"):
        read_comparison(unsaid)
