"""Mutation testing: change a line of what scores methods, and see if a test notices.

    make mutants

draws mutants of each module of `TARGETS`, runs the module's own tests on each in a copy of the
checkout, and writes `mutants.csv`, `score.csv` and `survivors.csv`. A mutant that no test notices
is a missing test, or changes nothing that can be seen: `explained.toml` says why. The mutants are
those of cosmic-ray: signs, comparisons, conditions and numbers.
"""

import argparse
import contextlib
import os
import random
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome
from joblib import Parallel, delayed

ROOT = Path(__file__).resolve().parents[2]
EXPLAINED = Path(__file__).with_name("explained.toml")
METRICS = "tests/benchmark/metrics"
TARGETS = {
    **{
        f"benchmark/metrics/{name}.py": (METRICS,)
        for name in (
            "image_metrics",
            "tactile",
            "operator_metrics",
            "evaluation",
            "aggregation",
            "uncertainty",
            "novelty",
        )
    },
    "benchmark/metrics/specs.py": (METRICS, "tests/benchmark/analysis/test_standings.py"),
    "benchmark/metrics/statistics.py": (
        f"{METRICS}/test_statistics.py",
        "tests/benchmark/analysis/test_standings.py",
    ),
    "benchmark/analysis/standings.py": ("tests/benchmark/analysis/test_standings.py",),
    "scenarios/imperfections/noise.py": (
        "tests/scenarios/imperfections/test_noise.py",
        "tests/scenarios/data/test_datasets.py",
    ),
    "scenarios/imperfections/calibration.py": (
        "tests/scenarios/imperfections/test_calibration.py",
    ),
    "scenarios/seeds.py": (
        "tests/scenarios/imperfections/test_noise.py",
        "tests/scenarios/phantoms/test_phantoms.py",
    ),
    "scenarios/guard.py": ("tests/scenarios/test_guard.py",),
    "scenarios/data/datasets.py": ("tests/scenarios/data/test_datasets.py",),
}
"""Modules by the tests that have to notice a change in them."""

# One mutant of each kind for an operator, and none of annotations.
_KINDS = re.compile(
    r"core/(ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|Pow_Mul|BitAnd_BitOr)"
    r"|ReplaceComparisonOperator_(Gt_GtE|GtE_Gt|Lt_LtE|LtE_Lt|Gt_Lt|Lt_Gt|GtE_LtE|LtE_GtE|Eq_NotEq"
    r"|NotEq_Eq|Is_IsNot|IsNot_Is|In_NotIn|NotIn_In)|NumberReplacer|ReplaceTrueWithFalse"
    r"|ReplaceFalseWithTrue|AddNot|ReplaceAndWithOr|ReplaceOrWithAnd|ZeroIterationForLoop"
    r"|ReplaceUnaryOperator_USub_UAdd)"
)


class Mutant(NamedTuple):
    """A mutant and what came of it."""

    module: str
    line: int
    kind: str
    before: str
    after: str
    survived: bool


def mutants(module: str, count: int, seed: int) -> list[MutationSpec]:
    """Draw `count` mutants of a module; 0: all."""
    with (
        tempfile.TemporaryDirectory() as folder,
        use_db(str(Path(folder) / "mutants.sqlite")) as db,
    ):
        init([Path(module)], db, {})
        found = [item.mutations[0] for item in db.work_items]
    found = sorted(
        (m for m in found if _KINDS.fullmatch(m.operator_name)),
        key=lambda m: (m.start_pos, m.operator_name, m.occurrence),
    )
    if 0 < count < len(found):
        found = random.Random(f"{module} {seed}").sample(found, count)
    return found


@contextlib.contextmanager
def checkout() -> Iterator[None]:
    """Work in a copy of the last commit, in which a module may be changed."""
    with tempfile.TemporaryDirectory() as folder:
        copy, before = Path(folder) / "copy", Path.cwd()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(copy)], check=True)  # noqa: S607
        os.chdir(copy)
        os.environ["PYTHONPATH"] = str(copy / "src")
        try:
            yield
        finally:
            os.chdir(before)


def run(module: str, tests: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Run the tests on mutants of a module."""
    flags = "-x -q -p no:xdist -p no:cacheprovider -m 'not nightly'"
    command = f"{sys.executable} -m pytest {flags} {' '.join(tests)}"
    found = []
    with checkout():
        done = subprocess.run(shlex.split(command), capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{module}: its tests fail without a mutant.\n{done.stdout[-2000:]}")
        for mutation in mutants(module, count, seed):
            result = mutate_and_test([mutation], command, timeout=600)
            lines = (result.diff or "").splitlines()
            changed = [line for line in lines if not line.startswith(("---", "+++"))]
            before, after = (
                " ".join(line[1:].strip() for line in changed if line.startswith(sign))
                for sign in "-+"
            )
            if before == after:
                continue  # a change of blanks
            kind = mutation.operator_name.removeprefix("core/")
            survived = result.test_outcome == TestOutcome.SURVIVED
            found.append(Mutant(module, mutation.start_pos[0], kind, before, after, survived))
            print("SURVIVED" if survived else "killed", *found[-1][:-1], sep="\t", flush=True)
    return found


def explanations(lost: pd.DataFrame) -> list[str]:
    """Why each mutant survives, by its changed line or the line before; "" where nobody said."""
    known = tomllib.loads(EXPLAINED.read_text())
    lines = lost[["module", "before", "after"]].itertuples(index=False)
    return [known.get(of, {}).get(new) or known.get(of, {}).get(old, "") for of, old, new in lines]


def main() -> None:
    """Draw, run and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help="only these; others keep what is stored")
    parser.add_argument("--count", type=int, default=0, help="mutants a module (0: all)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "studies" / "mutation")
    given = parser.parse_args()
    found = Parallel(n_jobs=given.jobs, batch_size=1)(
        delayed(run)(module, TARGETS[module], given.count, given.seed)
        for module in given.modules or TARGETS
    )
    table = pd.DataFrame([mutant for of in found for mutant in of], columns=Mutant._fields)
    stored = given.out / "mutants.csv"
    if given.modules and stored.is_file():
        old = pd.read_csv(stored)
        table = pd.concat([old[~old["module"].isin(given.modules)], table], ignore_index=True)
    order = list(TARGETS)
    table = table.sort_values("module", key=lambda of: of.map(order.index), kind="stable")
    lost = table[table["survived"]].drop(columns="survived")
    lost = lost.assign(why=explanations(lost))
    score = table.groupby("module", sort=False)["survived"].agg(mutants="size", survived="sum")
    explained_of = (lost["why"] != "").groupby(lost["module"]).sum()
    score["explained"] = explained_of.reindex(score.index, fill_value=0)
    given.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(stored, index=False)
    score.to_csv(given.out / "score.csv")
    lost.to_csv(given.out / "survivors.csv", index=False)
    print(score.to_string())
    if unexplained := int((score["survived"] - score["explained"]).sum()):
        sys.exit(f"{unexplained} mutants survive and nobody says why: test them, or explain them.")


if __name__ == "__main__":
    main()
