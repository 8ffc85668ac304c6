"""`tactorch doctor`: what works on this machine, and what to do about the rest."""

import json
import logging
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import asdict

from tactorch.cli.doctor.finding import Finding
from tactorch.errors import ConfigError

HELP = """\
tactorch doctor: what works on this machine, what is missing, and the commands that install it.

  tactorch doctor
  tactorch doctor json=true  # the same for programs

Packages are imported, solvers solve, the mesher meshes, a video is written and read back. The exit
status is 0 where the core works (simulate, invert, evaluate), and 1 where it does not."""

NOT_WELL = 1
_MARKS = {True: "yes", False: "NO", None: "-"}


def run(words: Sequence[str]) -> int:
    """Look at everything and tell it; returns the exit status.

    Raises:
        ConfigError: A setting is unknown.
    """
    as_json = _as_json(words)
    with nullcontext() if as_json else _patience():
        findings = list(look())
    well = all(one.works is not False for one in findings if one.core)
    if as_json:
        print(json.dumps({"works": well, "findings": [asdict(one) for one in findings]}, indent=2))
    else:
        _tell(findings, well)
    return 0 if well else NOT_WELL


def look() -> Iterator[Finding]:
    """Look at one part after the other."""
    from tactorch.cli.doctor.machine import look_at_machine
    from tactorch.cli.doctor.packages import look_at_packages
    from tactorch.cli.doctor.places import look_at_places
    from tactorch.cli.doctor.solvers import look_at_solvers

    parts: tuple[Callable[[], Iterator[Finding]], ...] = (
        look_at_packages,
        look_at_solvers,
        look_at_machine,
        look_at_places,
    )
    with _silence():
        for part in parts:
            yield from part()


def _as_json(words: Sequence[str]) -> bool:
    choices = {"json=true": True, "json=false": False}
    unknown = [word for word in words if word not in choices]
    if unknown:
        raise ConfigError(f"'{unknown[0]}' is no setting of it; it takes json=true alone.")
    return choices[words[-1]] if words else False


def _tell(findings: Sequence[Finding], well: bool) -> None:
    from tactorch.cli.tables import Table, show

    part = ""
    rows = []
    for one in findings:
        shown = one.part if one.part != part else ""
        rows.append((shown, one.name, _MARKS[one.works], one.message))
        part = one.part
    show(Table(("", "", "works", ""), rows, 4, {"yes": "green", "NO": "bold red"}))
    ill = [one for one in findings if one.works is False]
    print()
    if ill:
        print(
            "Not working, what that takes away, and what to do; the first may be why others fail:"
        )
        show(Table(("",) * 3, [(one.name, one.feature, one.remedy) for one in ill], 3))
        print()
    if not well:
        print("The core of tactorch does not work here.")
    elif ill:
        print("The core of tactorch works here; what is listed above does not.")
    else:
        print("All of tactorch works here.")


@contextmanager
def _silence() -> Iterator[None]:
    """Keep what packages say of themselves off the report."""
    disabled = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        # What they print would spoil the JSON.
        with warnings.catch_warnings(), redirect_stdout(sys.stderr):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)


@contextmanager
def _patience() -> Iterator[None]:
    """Show at a terminal that something is going on."""
    from tactorch.cli.tables import is_rich

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
    # Not redirected: packages that are imported meanwhile would keep rich's streams for good.
    with Live(
        Spinner("dots", "looking at packages, solvers and files ..."),
        console=Console(stderr=True),
        redirect_stdout=False,
        redirect_stderr=False,
        transient=True,
    ):
        yield
