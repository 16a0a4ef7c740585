"""Give spoilt files to every reader: `nice -n 19 python -m tests.security.fuzz --out FOLDER`.

File k of a target is made from the seed, the target's name and k alone, so that any of them can be
made again (`--again TARGET K`). A reader may take a file or refuse it with an `EitbenchError`;
everything else is a finding: another exception, a crash, more than `LIMIT_S`, or more than
`LIMIT_MB` of memory. Files are read in a process of their own per core, which is started anew where
one of them crashed or hung. What was done is kept in `--out`, and a second call goes on from there.
"""

from __future__ import annotations

import argparse
import json
import logging
import multiprocessing
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

import pandas as pd
from tests.security.mutations import pick
from tests.security.targets import Target, targets

from eitbench.scenarios.errors import EitbenchError

LIMIT_S = 10.0
"""A file may take this long."""
LIMIT_MB = 300
"""It may make the process grow by as much at most."""
ADDRESSES_MB = 8000
"""Addresses a process may claim beyond those it has: what is never touched takes no memory."""
CHUNK = 250


@dataclass
class Tally:
    """Results of reading the files of a target.

    Attributes:
        files: how many were read.
        taken: of which so many were taken; the others were refused.
        seconds: in all.
        slowest_s, most_mb: of one file.
        findings: number of the file and what happened.
    """

    files: int = 0
    taken: int = 0
    seconds: float = 0.0
    slowest_s: float = 0.0
    most_mb: float = 0.0
    findings: list[tuple[int, str]] = field(default_factory=list)


def spoilt(seed: int, name: str, target: Target, k: int) -> bytes:
    """File `k` of the target called `name`."""
    return pick(Random(f"{seed} {name} {k}"), target.originals, target.mutation)


def read(target: Target, path: Path) -> tuple[bool, str]:
    """Return True if the spoilt file was taken, and a problem in reading it; "" without one."""
    try:
        target.read(path)
    except EitbenchError as error:
        message = str(error)
        # One sentence on one line, whatever the file holds.
        return False, "" if message and "\n" not in message else f"sentence {message[:200]!r}"
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)
        place = next((f for f in reversed(where) if "eitbench" in f.filename), where[-1])
        at = f"{Path(place.filename).name}:{place.name}"
        return False, f"{type(error).__name__} at {at}: {str(error)[:160]}"
    return True, ""


def _serve(folder: Path, seed: int, known: dict[str, Target], pipe: Connection) -> None:
    """Read the files that are asked for, and answer one by one (in a forked process)."""
    memory = _memory_mb("VmSize:")
    limit = int((memory + ADDRESSES_MB) * 2**20)
    import resource  # not on Windows

    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    # Where a core file would go is not ours.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    logging.disable()
    while True:
        name, k = pipe.recv()
        target = known[name]
        path = folder / target.file
        content = spoilt(seed, name, target, k)
        path.unlink(missing_ok=True)
        path.write_bytes(content)
        Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
        before, start = _memory_mb("VmRSS:"), time.perf_counter()
        taken, problem = read(target, path)
        seconds, grown = time.perf_counter() - start, _memory_mb("VmHWM:") - before
        pipe.send((taken, problem, seconds, grown))


def _memory_mb(name: str) -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return int(line.split()[1]) / 1024
    raise KeyError(name)


class Reader:
    """A process that reads spoilt files."""

    def __init__(self, folder: Path, seed: int, known: dict[str, Target]) -> None:
        self._made = (folder, seed, known)
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(*self._made, theirs), daemon=True)
        self._process.start()
        theirs.close()

    def __call__(self, name: str, numbers: range, tally: Tally) -> None:
        """Read the files of a target and add what happened to `tally`."""
        for k in numbers:
            self._pipe.send((name, k))
            taken, problem, seconds, grown = self._answer()
            if not problem and grown > LIMIT_MB:
                problem = f"memory: {grown:.0f} MB"
            if not problem and seconds > LIMIT_S:
                problem = f"time: {seconds:.0f} s"
            tally.files += 1
            tally.taken += taken
            tally.seconds += seconds
            tally.slowest_s = max(tally.slowest_s, seconds)
            tally.most_mb = max(tally.most_mb, grown)
            if problem:
                tally.findings.append((k, problem))

    def _answer(self) -> tuple[bool, str, float, float]:
        problem = f"hang: more than {LIMIT_S:.0f} s"
        try:
            if self._pipe.poll(2 * LIMIT_S):
                answer: tuple[bool, str, float, float] = self._pipe.recv()
                return answer
        except (EOFError, ConnectionResetError):
            self._process.join()
            problem = f"crash: ended with {self._process.exitcode}"
        self.close()
        self._start()
        return False, problem, LIMIT_S, 0.0

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def drive(seed: int, files: int, out: Path, names: list[str] | None, part: slice) -> None:
    """Read the files of every target of `part`, going on from the tallies in `out`."""
    with tempfile.TemporaryDirectory() as place:
        known = targets(Path(place))
        sound(Path(place), known)
        reader = Reader(Path(place), seed, known)
        whole = sum(target.share for target in known.values())
        for name in [name for name in known if names is None or name in names][part]:
            stored = out / f"{name}-{seed}.json"
            tally = Tally(**json.loads(stored.read_text())) if stored.is_file() else Tally()
            wanted = -(-files * known[name].share // whole)
            while tally.files < wanted:
                reader(name, range(tally.files, min(tally.files + CHUNK, wanted)), tally)
                stored.with_suffix(".part").write_text(json.dumps(asdict(tally), indent=1))
                stored.with_suffix(".part").replace(stored)
        reader.close()


def sound(folder: Path, known: dict[str, Target]) -> None:
    """Make sure that every file is taken before it is spoilt."""
    for name, target in known.items():
        for original in target.originals:
            path = folder / target.file
            path.write_bytes(original)
            try:
                target.read(path)
            except EitbenchError as error:
                raise SystemExit(f"A whole file of {name!r} is not taken: {error}") from error


def again(seed: int, name: str, k: int) -> None:
    """Read file `k` of a target once more, in this process, with its traceback."""
    with tempfile.TemporaryDirectory() as place:
        target = targets(Path(place))[name]
        path = Path(place) / target.file
        path.unlink(missing_ok=True)
        path.write_bytes(spoilt(seed, name, target, k))
        target.read(path)


def main() -> int:
    """Fuzz as the command line says; 1 if anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=100_000, help="in all, of all targets")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="what was done is kept here")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", nargs="+", metavar="TARGET", help="these targets alone")
    parser.add_argument("--again", nargs=2, metavar=("TARGET", "K"), help="read one file once more")
    asked = parser.parse_args()
    if asked.again:
        again(asked.seed, asked.again[0], int(asked.again[1]))
        return 0
    asked.out.mkdir(parents=True, exist_ok=True)
    fork = multiprocessing.get_context("fork")
    drivers = [
        fork.Process(
            target=drive,
            args=(asked.seed, asked.files, asked.out, asked.only, slice(j, None, asked.jobs)),
        )
        for j in range(asked.jobs)
    ]
    for driver in drivers:
        driver.start()
    for driver in drivers:
        driver.join()
    return report(asked.seed, asked.out) or int(any(driver.exitcode for driver in drivers))


def report(seed: int, out: Path) -> int:
    """Print a line for each target and its findings, and write `fuzz.csv`; 1 if there is any."""
    found = 0
    print("target         files   taken  ms each slowest s  most MB")
    files = 0
    rows = []
    for stored in sorted(out.glob(f"*-{seed}.json")):
        tally = Tally(**json.loads(stored.read_text()))
        name, each = stored.stem.removesuffix(f"-{seed}"), 1e3 * tally.seconds / max(tally.files, 1)
        print(
            f"{name:<12} {tally.files:>7} {tally.taken:>7} {each:>8.2f} {tally.slowest_s:>9.2f} "
            f"{tally.most_mb:>8.0f}"
        )
        files += tally.files
        found += len(tally.findings)
        rows.append({
            "target": name, "files": tally.files, "taken": tally.taken, "findings":
            len(tally.findings), "slowest_s": tally.slowest_s, "most_mb": tally.most_mb,
        })  # fmt: skip
        alike = Counter(problem for _, problem in tally.findings)
        first = {problem: k for k, problem in reversed(tally.findings)}
        for problem, count in alike.most_common(40):
            print(f"    {count} x file {first[problem]}: {problem}")
    print(f"{files} files, {found} findings")
    table = pd.DataFrame(rows)
    table.to_csv(out / "fuzz.csv", index=False, float_format="%.3g", lineterminator="\n")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
