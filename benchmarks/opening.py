"""Computing time of opening a log that psmpc closed, and one that it must look at elsewhere first: docs/reliability.md.

python benchmarks/opening.py
"""

import shutil
import tempfile
import time
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

from pages import write_between

from psmpc_cli.logs.guard import Worker, ensure_readable
from psmpc_cli.logs.seal import unseal
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task


def sealed(path: Path) -> float:
    """Return the processor time of making sure that a log of one's own can be read [s]."""
    began = time.process_time()
    ensure_readable(path)
    return time.process_time() - began


def strange(*paths: Path) -> float:
    """Return that of the process that reads logs of others, once it has ended [s]."""
    began, worker = getrusage(RUSAGE_CHILDREN), Worker()
    for path in paths:
        worker.ask(str(path))
    worker.close()
    ended = getrusage(RUSAGE_CHILDREN)
    return ended.ru_utime + ended.ru_stime - began.ru_utime - began.ru_stime


def main() -> None:
    """Make logs, open them, and write the table."""
    lines = ["| log of the transport task | size | own, sealed | read in the other process |", "|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "none.h5").write_bytes(b"no HDF5")
        start = min(strange(folder / "none.h5") for _ in range(3))
        for nodes in (25, 100, 400):
            log, other = folder / f"{nodes}.h5", folder / f"{nodes}-other.h5"
            simulate(load_task("transport", [f"controller.nodes={nodes}", "log.shares=false"]), log)
            shutil.copy(log, other)
            unseal(other)
            own, read = sealed(log), min(strange(other) for _ in range(3)) - start
            lines.append(f"| N_s = {nodes} | {log.stat().st_size / 1e6:.0f} MB | {own:.2f} s | {read:.2f} s |")
    lines.append(f"| the start of the other process, once a command | | | {start:.2f} s |")
    write_between("reliability.md", "opening", lines)


if __name__ == "__main__":
    main()
