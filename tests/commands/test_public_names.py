"""The public names of eitbench: complete, and imported when they are first used."""

import subprocess
import sys

import eitbench
from eitbench import methods, scenarios


def test_the_package_shows_the_public_names_of_scenarios_and_methods() -> None:
    # `eitbench.methods` and `eitbench.methods.operators` are subpackages.
    known = {*dir(scenarios), *methods.__all__, "operators"} - {"methods"}
    known |= {"evaluate", "plot", "training_data"}
    assert set(dir(eitbench)) == known
    for name in dir(scenarios):
        assert getattr(eitbench, name) is getattr(scenarios, name)
    assert all(callable(getattr(eitbench, name)) for name in known)


def test_importing_it_imports_nothing_heavy() -> None:
    """Nor does the help of the command line."""
    program = (
        "import sys, eitbench.scenarios\n"
        "assert 'numpy' not in sys.modules\n"
        "from eitbench import cli\n"
        "sys.argv = ['eitbench', '--help']\n"
        "try:\n    cli.main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'pyarrow', 'h5py', 'matplotlib', 'pydantic'}\n"
        "heavy |= {'torch', 'numba'}\n"
        "sys.exit(str(sorted(heavy & set(sys.modules)) or ''))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr.strip() == ""
    assert "leaderboard" in done.stdout
