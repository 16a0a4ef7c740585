"""No file of ours unpickles, evaluates, or starts a shell: a walk over the syntax trees of all.

Between processes of our own, multiprocessing (requests to workers) and joblib (with loky, which
uses cloudpickle) pickle what goes through their pipes: nothing of it is a file or comes from
outside. What workers answer is never unpickled. docs/security.md says so, and the only modules that
may use them are listed here.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.source_files import source_files

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("scenarios", "methods", "benchmark", "hardware", "reports", "src/eitbench")
FILES = source_files(*FOLDERS)

FORBIDDEN_MODULES = {
    "pickle", "cPickle", "_pickle", "dill", "cloudpickle", "marshal", "shelve", "jsonpickle",
    "tarfile", "code", "telnetlib", "xml", "yaml",
}  # fmt: skip
FORBIDDEN_CALLS = {
    "eval", "exec", "compile", "__import__", "os.system", "os.popen", "subprocess.getoutput",
    "subprocess.getstatusoutput", "joblib.load", "joblib.dump", "joblib.Memory", "pd.read_pickle",
    "torch.load", "torch.save", "torch.jit.load", "shutil.unpack_archive", "tempfile.mktemp",
    "np.lib.format.read_array",
}  # fmt: skip
FORBIDDEN_METHODS = {"extractall", "extract", "to_pickle", "unpack_archive"}

BETWEEN_OUR_PROCESSES = {
    "benchmark/ceiling/drawing.py", "benchmark/run/executors.py", "benchmark/run/method_cell.py",
    "benchmark/workers/confinement.py",
    "benchmark/workers/process.py", "benchmark/workers/worker.py",
    "benchmark/studies/priors.py", "benchmark/studies/readings.py",
    "benchmark/studies/training_study.py", "methods/learned/refiner_training.py",
    "reports/page/report.py", "scenarios/interrupts.py",
    "scenarios/data/datasets.py", "scenarios/data/simulation.py",
}  # fmt: skip


def called(node: ast.expr) -> str:
    """The dotted name of what is called; "" where it has none."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return f"{called(node.value)}.{node.attr}".lstrip(".")
    return ""


def imported(tree: ast.AST) -> Iterator[str]:
    """The top-level names of all modules that are imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").split(".")[0]


def offences(source: str) -> list[str]:
    """Imports and calls in `source` that no file of ours may have."""
    tree = ast.parse(source)
    found = [f"imports {name}" for name in imported(tree) if name in FORBIDDEN_MODULES]
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name, options = called(node.func), {word.arg: word.value for word in node.keywords}
        if name in FORBIDDEN_CALLS or (
            isinstance(node.func, ast.Attribute) and node.func.attr in FORBIDDEN_METHODS
        ):
            found.append(f"calls {name}")
        for option in ("shell", "allow_pickle"):
            value = options.get(option)
            if value is not None and not (isinstance(value, ast.Constant) and value.value is False):
                found.append(f"calls {name} with {option}")
        if name == "np.load" and "allow_pickle" not in options:
            found.append("calls np.load without allow_pickle=False")
    return found


def test_all_files_are_looked_at() -> None:
    assert len(FILES) > 150
    assert ROOT / "benchmark" / "rundir" / "store.py" in FILES


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from dill import loads",
        "import xml.etree.ElementTree",
        "eval('1')",
        "exec(text)",
        "os.system('ls')",
        "subprocess.run(words, shell=True)",
        "subprocess.run(words, shell=asked)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "torch.load(path)",
        "torch.load(path, weights_only=True)",
        "joblib.load(path)",
        "joblib.Memory(folder)",
        "tarfile.open(path).extractall()",
        "zipfile.ZipFile(path).extract(name)",
        "shutil.unpack_archive(path)",
        "pd.read_pickle(path)",
    ],
)
def test_what_is_forbidden_is_found(source: str) -> None:
    assert offences(source)


@pytest.mark.parametrize(
    "source",
    ["np.load(path, allow_pickle=False)", "network.eval()", "subprocess.run(words, shell=False)",
     "re.compile('a')", "ast.literal_eval(text)"],
)  # fmt: skip
def test_what_is_allowed_is_not(source: str) -> None:
    assert not offences(source)


@pytest.mark.slow
def test_no_file_of_ours_does_what_is_forbidden() -> None:
    found = {
        str(path.relative_to(ROOT)): problems
        for path in FILES
        if (problems := offences(path.read_text(encoding="utf-8")))
    }
    assert not found


@pytest.mark.slow
def test_only_known_modules_pickle_between_our_processes() -> None:
    users = {
        str(path.relative_to(ROOT))
        for path in FILES
        if {"multiprocessing", "joblib", "distributed"}
        & set(imported(ast.parse(path.read_text(encoding="utf-8"))))
    }
    assert users == BETWEEN_OUR_PROCESSES
