"""Checks of a method's process: output, threads, memory, time, files, network, programs."""

import numpy as np

from eitbench.benchmark.checks.harness import require, require_answer
from eitbench.benchmark.checks.method_interface import SAME_FRAME
from eitbench.benchmark.checks.method_under_test import Growth, MethodUnderTest
from eitbench.benchmark.workers.audit_hook import Kind

MEMORY_MIB = 4.0
"""Allowed growth of memory, which allocators keep for later.

It is two huge pages of Linux. A method that keeps its images of 40 x 40 pixels grows by 7 MiB over
600 frames; a slow one is asked for fewer, so that it has to keep more of each to be found.
"""

BATCH = 8


def quiet(tested: MethodUnderTest) -> None:
    """Require that nothing is printed, as it would stand between others' output."""
    tested.images(tested.contact)
    before = tested.log.stat().st_size
    tested.again(tested.contact)
    text = tested.log.read_text(errors="replace")[before:].strip()
    require(not text, f"reconstruct prints: {text[:80]!r}.")


def threads(tested: MethodUnderTest) -> str:
    """Require the same images on two threads as on one."""
    one = tested.again(tested.contact)
    two = tested.refit(tested.contact, threads=2)
    return tested.close(one, two, SAME_FRAME, "images made on one thread and on two")


def memory(tested: MethodUnderTest) -> str:
    """Require that frames leave nothing in memory."""
    tested.images(tested.contact)
    growth: Growth = require_answer(tested.worker.request("repeat", tested.contact)).value
    said = (
        f"memory grows by {max(growth.mib, 0.0):.2g} MiB over {growth.calls} frames; "
        f"{MEMORY_MIB:g} is allowed."
    )
    require(growth.mib <= MEMORY_MIB, said)
    return said


def no_network(tested: MethodUnderTest) -> None:
    """Require that no network is used."""
    _require_unseen(tested, "network", "it uses the network", "methods work without one")


def no_writing(tested: MethodUnderTest) -> None:
    """Require that files are written to the temporary folder or eitbench's cache only."""
    advice = "`tempfile` and eitbench's cache are where a method may write"
    _require_unseen(tested, "write", "it writes or changes files elsewhere", advice)


def no_programs(tested: MethodUnderTest) -> None:
    """Require that no other program is started, as no check can see what it does."""
    advice = "what they do is not seen, so that a reason is needed"
    _require_unseen(tested, "program", "it starts other programs", advice)


def _require_unseen(tested: MethodUnderTest, kind: Kind, what: str, advice: str) -> None:
    """Require that nothing of the `kind` was noted while the method was loaded, fitted, asked."""
    tested.images(tested.contact)
    noted = tested.watch.noted(kind)
    more = f" and {len(noted) - 1} more" if len(noted) > 1 else ""
    require(not noted, f"{what} ({noted[0]}{more}): {advice}." if noted else "")


def in_time(tested: MethodUnderTest) -> str:
    """Require an answer to a batch within the limit."""
    factors = np.linspace(0.4, 0.9, BATCH)
    frames = np.concatenate([tested.inclusion(float(factor)) for factor in factors])
    reply = require_answer(tested.worker.request("reconstruct", frames))
    fit_s = tested.worker.request("fit_s").value
    return (
        f"fitted in {fit_s:.2g} s, {BATCH} frames in {reply.seconds:.2g} s; "
        f"{tested.limit_s:g} s each are allowed."
    )
