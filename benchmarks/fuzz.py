"""Feeds psmpc wrong descriptions, command lines and HDF5 files, and counts what came of them: docs/reliability.md.

    python benchmarks/fuzz.py [COUNT] [KIND ...] [--from SEED] [--notes N]

COUNT is the number of distinct mutations, 100000 by default, spread over the kinds: yaml, lines, hdf5, commands, runs.
Every case has a seed and is made again with `python benchmarks/fuzz.py 1 KIND --from SEED`; what was fed before counts
once. Each kind runs in a process of its own, which is started again where a case ends it or hangs. The exit code is 1
if anything was met that must not happen.
"""

import argparse
import hashlib
import itertools
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


from psmpc_cli.errors import LogError, SpecError
from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, SWEEP
from psmpc_cli.specs.load import load_robot, load_task
from psmpc_cli.studies.fronts import read_pareto
from psmpc_cli.studies.monte_carlo import read_monte_carlo
from tests.bad_input import LINES, RESULTS, Verdict, judged, prepare, simulated, states, tidy
from tests.mutated_files import mutated_bytes, mutated_file
from tests.mutated_text import mutated_description, mutated_line, mutated_settings

SHARES = {"yaml": 0.79, "lines": 0.05, "hdf5": 0.14, "commands": 0.01, "runs": 0.01}

SLOW, HANGS = 10.0, 120.0
"""What may take this long: a refusal, and a command that was accepted after all [s]."""

ON_LOGS: tuple[tuple[str, ...], ...] = (
    ("show", "bad.h5"),
    ("show", "bad.h5"),
    ("show", "bad.h5"),
    ("replay", "bad.h5", "--step", "2"),
    ("verify", "bad.h5", "--every", "5"),
    ("rerun", "bad.h5"),
    ("simulate", "--continue", "bad.h5", "--no-figures"),
    ("plot", "bad.h5", "-o", "new"),
    ("show", "bad.h5", "--csv", "new"),
    ("pareto", "bad.h5", "--stages", "1,2", "--points", "3", "--jobs", "1", "-o", "new.h5", "--no-figures"),
)


ON_ANY = (("show", "bad.h5"), ("plot", "bad.h5", "-o", "new"))
"""Those of them for files of every kind."""

READERS: dict[str, Callable[[Path], object]] = {
    COMPARISON: read_comparison,
    SWEEP: lambda path: read_results(path, SWEEP),
    PARETO: read_pareto,
    MONTE_CARLO: read_monte_carlo,
}


@dataclass(frozen=True)
class Case:
    """One case: its seed, what came of it, how long it took [s], and a digest of what was fed."""

    seed: int
    verdict: Verdict
    seconds: float
    digest: str


original = cache(load_task)


def described(random: Random, folder: Path) -> tuple[bytes, Verdict]:
    """Load a task with a mutated task or robot file."""
    task = original(random.choice(["transport", "tracking", "approach_capture", str(folder / "task.yaml")]))
    texts = {"bad.yaml": task.task_yaml, "planar_dual_arm": task.robot_yaml}
    wrong = "bad.yaml" if random.random() < 0.75 else "planar_dual_arm"
    content = {name: text.encode() for name, text in texts.items()} | {wrong: mutated_description(texts[wrong], random)}
    for name, data in content.items():
        (folder / name).write_bytes(data)
    try:
        load_task(folder / "bad.yaml")
        if wrong != "bad.yaml":
            load_robot(folder / wrong)
    except SpecError as error:
        short = len(str(error)) < 30_000 and ":" in str(error)
        return content[wrong], Verdict("refused", "" if short else f"no clear message: {str(error)[:300]}")
    except Exception as error:
        return content[wrong], Verdict("traceback", f"{type(error).__name__}: {error}")
    return content[wrong], Verdict("accepted")


def told(random: Random, folder: Path) -> tuple[bytes, Verdict]:
    """Run a mutated command line."""
    arguments = mutated_line(random.choice(LINES), random)
    return repr(arguments).encode(), judged(arguments)


def opened(random: Random, folder: Path) -> tuple[bytes, Verdict]:
    """Read a mutated HDF5 file as what it says it is."""
    fed, path = spoilt(random, folder, RESULTS), Path("bad.h5")
    try:
        READERS.get(kind_of(path), read_run)(path)
    except LogError as error:
        clear = len(str(error)) < 1000 and str(error).startswith("bad.h5: ")
        return fed, Verdict("refused", "" if clear else f"no clear message: {str(error)[:300]}")
    except Exception as error:
        return fed, Verdict("traceback", f"{type(error).__name__}: {error}")
    return fed, Verdict("accepted")


def begun(random: Random, folder: Path) -> tuple[bytes, Verdict]:
    """Give a mutated log to any other command."""
    line = random.choice(ON_LOGS)
    fed = spoilt(random, folder, RESULTS if line in ON_ANY else ("part.h5", "ended.h5"))
    return fed, judged(list(line))


def run(random: Random, folder: Path) -> tuple[bytes, Verdict]:
    """Run a task with numbers of any magnitude."""
    settings = mutated_settings(random)
    return repr(settings).encode(), simulated(settings)


def spoilt(random: Random, folder: Path, names: tuple[str, ...]) -> bytes:
    """Write a mutated file and return its content."""
    path = folder / "bad.h5"
    shutil.copy(folder / random.choice(names), path)
    if random.random() < 0.25:
        mutated_file(path, random)
    else:
        path.write_bytes(mutated_bytes(path.read_bytes(), random))
    return path.read_bytes()


KINDS: dict[str, Callable[[Random, Path], tuple[bytes, Verdict]]] = {
    "yaml": described,
    "lines": told,
    "hdf5": opened,
    "commands": begun,
    "runs": run,
}


def serve(kind: str, first: int, folder: Path, answers: Connection) -> None:
    """Run cases one after another and tell each."""
    os.chdir(folder)
    warnings.simplefilter("error")
    kept = states(folder)
    originals = {name: (folder / name).read_bytes() for name in RESULTS}
    for seed in itertools.count(first):
        random = Random(f"{kind} {seed}")
        began = time.perf_counter()
        fed, verdict = KINDS[kind](random, folder)
        seconds = time.perf_counter() - began
        changed = tidy(folder, kept)
        if changed:
            if kind != "lines" or not ({b"--force", b"--continue"} & set(fed.replace(b"'", b" ").split())):
                verdict = Verdict("changed a file", ", ".join(changed))
            for name, content in originals.items():
                (folder / name).write_bytes(content)
            kept = states(folder)
        if verdict.word == "refused" and seconds > SLOW:
            verdict = Verdict("slow", f"{seconds:.1f} s")
        answers.send(Case(seed, verdict, seconds, hashlib.sha256(fed).hexdigest()))


def cases(kind: str, first: int) -> Iterator[Case]:
    """Give every case of a kind; the process that runs them is started again where one ends it or hangs."""
    spawn = multiprocessing.get_context("spawn")
    seed = first
    while True:
        with tempfile.TemporaryDirectory(prefix="psmpc-fuzz-") as name:
            prepare(Path(name))
            mine, theirs = spawn.Pipe(duplex=False)
            process = spawn.Process(target=serve, args=(kind, seed, Path(name), theirs), daemon=False)
            process.start()
            theirs.close()
            try:
                while True:
                    if not mine.poll(HANGS):
                        raise TimeoutError
                    yield mine.recv()
                    seed += 1
            except TimeoutError:
                yield Case(seed, Verdict("hang", f"more than {HANGS} s"), HANGS, "")
                seed += 1
            except EOFError:
                process.join()
                yield Case(seed, Verdict("crash", f"exit code {process.exitcode}"), 0.0, "")
                seed += 1
            finally:
                process.kill()
                process.join()


def main() -> int:
    """Run all and print what came of it."""
    parser = argparse.ArgumentParser(description="Feeds psmpc wrong input and counts what came of it.")
    parser.add_argument("count", type=int, nargs="?", default=100_000)
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], default=[])
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="SEED")
    parser.add_argument("--notes", type=int, default=10, help="Findings of a kind that are written out.")
    asked = parser.parse_args()
    kinds = asked.kinds or list(KINDS)
    share = sum(SHARES[kind] for kind in kinds)
    findings = 0
    for kind in kinds:
        words: Counter[str] = Counter()
        digests: set[str] = set()
        longest, began = Counter[str](), time.perf_counter()
        wanted = max(1, round(asked.count * SHARES[kind] / share))
        for case in cases(kind, asked.first):
            if case.digest in digests:
                continue
            words[case.verdict.word] += 1
            digests |= {case.digest} if case.digest else set()
            longest[case.verdict.word] = max(longest[case.verdict.word], case.seconds)
            if sum(words.values()) % 2000 == 0:
                print(f"  {kind}: {dict(words)} after {time.perf_counter() - began:.0f} s", flush=True)
            if case.verdict.is_finding:
                findings += 1
                if findings <= asked.notes:
                    print(f"  {kind} {case.seed}: {case.verdict.word}: {case.verdict.note}", flush=True)
            if sum(words.values()) == wanted:
                break
        counts = ", ".join(f"{count} {word} (at most {longest[word]:.1f} s)" for word, count in words.most_common())
        spent = time.perf_counter() - began
        print(f"{kind}: {sum(words.values())} distinct cases: {counts}; {spent:.0f} s", flush=True)
    return 1 if findings else 0


if __name__ == "__main__":
    raise SystemExit(main())
