"""`tactorch doctor`: what works on this machine, and what to do about the rest."""

import json
import logging
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import asdict

from tactorch.cli import installation
from tactorch.cli.console import Table, is_rich, show
from tactorch.cli.installation import Finding
from tactorch.errors import ConfigError

HELP = """\
tactorch doctor: what works on this machine, what is missing, and the commands that install it.

  tactorch doctor
  tactorch doctor json=true  # the same for programs

Packages are imported, solvers solve, the mesher meshes, a video is written and read back. The exit
status is 0 where the core works (simulate, invert, evaluate), and 1 where it does not."""

_MARKS = {True: "yes", False: "NO", None: "-"}


def run(words: Sequence[str]) -> int:
    """Check the installation and print the findings; return the exit status."""
    choices = {"json=true": True, "json=false": False}
    unknown = [word for word in words if word not in choices]
    if unknown:
        raise ConfigError(f"'{unknown[0]}' is no setting of it; it takes json=true alone.")
    as_json = bool(words) and choices[words[-1]]
    with nullcontext() if as_json else _spinner():
        findings = list(check_all())
    core_works = all(finding.works is not False for finding in findings if finding.core)
    if as_json:
        result = {"works": core_works, "findings": [asdict(finding) for finding in findings]}
        print(json.dumps(result, indent=2))
    else:
        _print_findings(findings, core_works)
    return 0 if core_works else 1


def check_all() -> Iterator[Finding]:
    """Yield the findings on packages, solvers, machine, folders and programs."""
    disabled = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        # Output of packages would spoil the JSON.
        with warnings.catch_warnings(), redirect_stdout(sys.stderr):
            warnings.simplefilter("ignore")
            yield from installation.check_packages()
            yield from installation.check_solvers()
            yield from installation.check_machine()
            yield from installation.check_places()
    finally:
        logging.disable(disabled)


def _print_findings(findings: Sequence[Finding], core_works: bool) -> None:
    rows, part = [], ""
    for f in findings:
        rows.append((f.part if f.part != part else "", f.name, _MARKS[f.works], f.message))
        part = f.part
    show(Table(("", "", "works", ""), rows, 4, {"yes": "green", "NO": "bold red"}))
    failures = [(f.name, f.feature, f.remedy) for f in findings if f.works is False]
    print()
    if failures:
        title = "Not working, affected features and remedies"
        print(f"{title}; the first may be why others fail:")
        show(Table(("",) * 3, failures, 3))
        print()
    if not core_works:
        print("The core of tactorch does not work here.")
    elif failures:
        print("The core of tactorch works here; what is listed above does not.")
    else:
        print("All of tactorch works here.")


@contextmanager
def _spinner() -> Iterator[None]:
    """Show a spinner at a terminal."""
    try:
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner
    except ImportError:  # reported among the packages
        yield
        return
    if not is_rich(sys.stderr):
        yield
        return
    spinner = Spinner("dots", "looking at packages, solvers and files ...")
    console = Console(stderr=True)
    # Not redirected: packages that are imported meanwhile would keep rich's streams for good.
    with Live(
        spinner, console=console, redirect_stdout=False, redirect_stderr=False, transient=True
    ):
        yield
