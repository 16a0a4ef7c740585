"""SIGTERM and SIGHUP interrupt once, as Ctrl-C does."""

import os
import signal
import threading

import pytest

from eitbench.scenarios.interrupts import termination_interrupts

if not hasattr(signal, "SIGHUP"):
    pytest.skip("this system has no SIGHUP", allow_module_level=True)
ENDS = [signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("number", ENDS)
def test_a_signal_interrupts_once_so_that_all_is_stored(number: signal.Signals) -> None:
    before, stored = signal.getsignal(number), []

    def work() -> None:
        with termination_interrupts():
            try:
                os.kill(os.getpid(), number)
            finally:  # a terminal that is closed sends more than one
                for again in ENDS:
                    os.kill(os.getpid(), again)
                stored.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert stored
    assert signal.getsignal(number) is before


def test_an_ignored_signal_stays_ignored() -> None:
    """As `nohup` leaves it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with termination_interrupts():
            os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_outside_the_main_thread_nothing_changes() -> None:
    before, found = signal.getsignal(signal.SIGTERM), []

    def work() -> None:
        with termination_interrupts():
            found.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [before]
