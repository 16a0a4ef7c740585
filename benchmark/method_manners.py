"""Checks of how a method behaves in its process: threads, memory, time, files, network."""

import numpy as np

from eitbench.benchmark.audit import Kind
from eitbench.benchmark.checked_method import Growth
from eitbench.benchmark.checking import require
from eitbench.benchmark.method_contract import SAME_FRAME
from eitbench.benchmark.method_subject import Subject

MEMORY_MIB = 4.0
"""By how much memory may grow: what allocators keep for later.

It is two huge pages of Linux. A method that keeps its images of 40 x 40 pixels grows by 7 MiB over
600 frames; a slow one is asked for fewer, so that it has to keep more of each to be found.
"""

BATCH = 8


def quiet(subject: Subject) -> None:
    """What is printed stands between others' output."""
    subject.images(subject.contact)
    before = subject.log.stat().st_size
    subject.again(subject.contact)
    text = subject.log.read_text(errors="replace")[before:].strip()
    require(not text, f"reconstruct prints: {text[:80]!r}.")


def threads(subject: Subject) -> str:
    """Fitted and asked on two threads, it sees what it sees on one."""
    one = subject.again(subject.contact)
    two = subject.refit(subject.contact, threads=2)
    return subject.close(one, two, SAME_FRAME, "images made on one thread and on two")


def memory(subject: Subject) -> str:
    """Frames leave nothing behind."""
    subject.images(subject.contact)
    reply = subject.worker.ask("repeat", subject.contact)
    require(reply.failure is None, f"{reply.failure.message}." if reply.failure else "")
    growth: Growth = reply.value
    said = (
        f"memory grows by {max(growth.mib, 0.0):.2g} MiB over {growth.calls} frames; "
        f"{MEMORY_MIB:g} is allowed."
    )
    require(growth.mib <= MEMORY_MIB, said)
    return said


def no_network(subject: Subject) -> None:
    """Images come from frames, on a machine without network too."""
    _unseen(subject, "network", "it uses the network", "methods work without one")


def no_writing(subject: Subject) -> None:
    """Files go to the temporary folder or eitbench's cache."""
    advice = "`tempfile` and eitbench's cache are where a method may write"
    _unseen(subject, "write", "it writes or changes files elsewhere", advice)


def no_programs(subject: Subject) -> None:
    """What another program does, no check can see."""
    advice = "what they do is not seen, so that a reason is needed"
    _unseen(subject, "program", "it starts other programs", advice)


def _unseen(subject: Subject, kind: Kind, what: str, advice: str) -> None:
    """Require that nothing of the `kind` was noted while the method was loaded, fitted, asked."""
    subject.images(subject.contact)
    noted = subject.watch.noted(kind)
    more = f" and {len(noted) - 1} more" if len(noted) > 1 else ""
    require(not noted, f"{what} ({noted[0]}{more}): {advice}." if noted else "")


def in_time(subject: Subject) -> str:
    """A batch is answered before it is given up on."""
    factors = np.linspace(0.4, 0.9, BATCH)
    frames = np.concatenate([subject.inclusion(float(factor)) for factor in factors])
    reply = subject.worker.ask("reconstruct", frames)
    require(reply.failure is None, f"{reply.failure.message}." if reply.failure else "")
    fit_s = subject.worker.ask("fit_s").value
    return (
        f"fitted in {fit_s:.2g} s, {BATCH} frames in {reply.seconds:.2g} s; "
        f"{subject.limit_s:g} s each are allowed."
    )
