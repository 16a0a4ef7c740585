"""Looks up every installed package in the public databases of vulnerabilities: `make audit`.

A known vulnerability fails. Where no database can be reached, that is said and nothing fails:
nobody could do anything about it here.
"""

import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

SERVICES = ("pypi", "osv")
UNREACHED = "No database of vulnerabilities can be reached from here: nothing was audited."

Report = dict[str, Any]


def ask(service: str) -> Report:
    """Return the report of pip-audit on the database `service`; empty where it has none."""
    words = ["--local", "--progress-spinner", "off", "--timeout", "20", "--format", "json"]
    command = [sys.executable, "-m", "pip_audit", *words, "--vulnerability-service", service]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        report: Report = json.loads(done.stdout)
    except ValueError:
        return {}
    return report


def audit(ask: Callable[[str], Report] = ask) -> tuple[list[str], int]:
    """Return sentences on the installed packages, and the exit code."""
    for service in SERVICES:
        # pip is that of the Python here: it is no dependency, and nobody installs it by ours.
        found = ask(service).get("dependencies", [])
        packages = [package for package in found if package["name"] != "pip"]
        known = [package for package in packages if "vulns" in package]
        if known:
            return _sentences(known, len(packages) - len(known), service)
    return [UNREACHED], 0


def _sentences(known: list[Report], unknown: int, service: str) -> tuple[list[str], int]:
    found = [
        f"{package['name']} {package['version']} has the known vulnerability {problem['id']}: "
        f"{_remedy(problem['fix_versions'])}."
        for package in known
        for problem in package["vulns"]
    ]
    count = f"{len(known)} packages looked up in {service}: {len(found)} known vulnerabilities"
    rest = f"; {unknown} packages are not listed there." if unknown else "."
    return [*found, count + rest], int(bool(found))


def _remedy(versions: list[str]) -> str:
    return f"install {' or '.join(versions)}" if versions else "no version without it is known"


if __name__ == "__main__":
    sentences, code = audit()
    print("\n".join(sentences))
    sys.exit(code)
