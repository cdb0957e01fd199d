from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

QUICK = ("controller.nodes=8", "plant.kind=ideal", "time_limit=11")
EQUAL = tuple(f"stages.{stage}.priority=1" for stage in ("approach", "capture", "transport", "release"))
WALL_TIMES = {"solver/wall_time"}


def datasets(path: Path) -> dict[str, np.ndarray]:
    """Return every dataset of a log by its path."""
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("other", [("controller.kind=smpc",), EQUAL], ids=["smpc", "again"])
def test_logs_equal_in_every_dataset_but_the_wall_times(tmp_path: Path, other: tuple[str, ...]) -> None:
    """SMPC is PSMPC with all priorities 1, and a run repeated is the same run."""
    for name, changes in (("one", EQUAL), ("other", other)):
        simulate(load_task("transport", (*QUICK, *changes)), tmp_path / f"{name}.h5")
    one, another = datasets(tmp_path / "one.h5"), datasets(tmp_path / "other.h5")
    assert one.keys() == another.keys()
    assert len(one) > 40
    assert np.isfinite(one["window/instants"]).any()
    for name in one.keys() - WALL_TIMES:
        np.testing.assert_array_equal(one[name], another[name], err_msg=name)
