"""One command as a Hydra app, whose every error is one message on standard error."""

import importlib
import importlib.util
import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from tactorch.cli.catalog import PACKAGE, Catalog, app_name, conf_folder
from tactorch.cli.logs import to_log_file
from tactorch.cli.status import INTERRUPTED, WRONG
from tactorch.cli.tables import is_rich
from tactorch.text import printable

if TYPE_CHECKING:
    from omegaconf import DictConfig

# What is no name in Python.
_MODULES = {"import": "import_", "evaluate-model": "evaluate_model"}
_DEBUG = "HYDRA_FULL_ERROR"


def run_app(verb: str, given: Sequence[str]) -> None:
    """Run the Hydra app of a command; ends the process with a status other than 0 on errors."""
    from tactorch.cli.error_messages import unknown_flag
    from tactorch.cli.help import help_text, wants_help
    from tactorch.cli.resume import with_resume
    from tactorch.errors import TactorchError

    if wants_help(given):
        print(help_text(verb, given))
        return
    try:
        settings = with_resume(verb, list(given))
    except TactorchError as error:
        fail(str(error), verb)
    wrong = unknown_flag(verb, settings)
    if wrong:
        fail(wrong, verb)
    app = App(verb, settings)
    try:
        app.run()
    except KeyboardInterrupt:
        print(f"tactorch {verb}: interrupted{app.how_to_go_on()}", file=sys.stderr)
        sys.exit(INTERRUPTED)
    if app.failed:
        sys.exit(WRONG)


class App:
    """A command with its settings; Hydra calls `job`, once or, in a sweep, for each combination."""

    def __init__(self, verb: str, settings: list[str]) -> None:
        """Take the name of the command and its settings as typed."""
        self.verb = verb
        self.settings = settings
        self.failed = False
        self.began = False
        self.place: Path | None = None
        self._outputs: set[Path] = set()

    def run(self) -> None:
        """Hand over to Hydra."""
        import hydra

        debugging = os.environ.get(_DEBUG) == "1"
        with _process_of(self.verb, self.settings):
            name = app_name(self.verb)
            app = hydra.main(version_base="1.3", config_path=_conf(), config_name=name)
            try:
                app(self.job)()
            except Exception as error:
                if debugging or self.began:
                    raise
                from tactorch.cli.error_messages import complaint

                fail(complaint(error, self.verb, self.settings), self.verb)

    def job(self, cfg: "DictConfig") -> Any:
        """Run the command once; errors raised on purpose become a message."""
        from hydra.core.hydra_config import HydraConfig

        from tactorch.cli.kinds import check_settings
        from tactorch.errors import TactorchError
        from tactorch.versions import versions

        self.began = True
        self.place = Path(HydraConfig.get().runtime.output_dir)
        note = ", ".join(f"{name} {version}" for name, version in versions().items())
        to_log_file(f"tactorch {self.verb} with {note}")
        try:
            check_settings(cfg, Catalog(self.verb), self.settings)
            self._check_output(cfg.get("out"))
            with _plain_warnings(), _no_lines_in_the_bar():
                return _module(self.verb).run(cfg)
        except TactorchError as error:
            self._complain(str(error))
        except OSError as error:
            self._complain(f"{error}; check that path, its permissions and the free space.")
        except MemoryError as error:
            self._complain(
                f"out of memory ({error}); use a coarser mesh, fewer presses or optimizer=lbfgs."
            )
        return None

    def how_to_go_on(self) -> str:
        """Return the rest of a sentence, where a run that was stopped can go on."""
        from tactorch.cli.resume import has_state

        if self.place is None or not has_state(self.verb, self.place):
            return ""
        place = Path(os.path.relpath(self.place))
        return f"; go on with tactorch {self.verb} resume={place}"

    def _complain(self, message: str) -> None:
        """Say what went wrong; other jobs of a sweep still run."""
        self.failed = True
        _say(message, self.verb)
        to_log_file(f"error: {message}", error=True)

    def _check_output(self, out: str | None) -> None:
        """Refuse that jobs of a sweep write the same file."""
        from tactorch.errors import ConfigError

        if out is None:
            return
        path = Path(out).resolve()
        if path in self._outputs:
            raise ConfigError(
                f"out={out} is written by more than one job; put what differs in its name, as in "
                "out='x-${seed}.h5', or leave it out: each job has a folder of its own."
            )
        self._outputs.add(path)


def fail(message: str, verb: str = "") -> NoReturn:
    """Print one message and leave."""
    _say(message, verb)
    sys.exit(WRONG)


def _say(message: str, verb: str) -> None:
    """Print an error as one line, whatever the library that it comes from put between."""
    line = printable(" ".join(message.split()))
    print(f"tactorch {verb}".rstrip() + f": error: {line}", file=sys.stderr)


def _module(verb: str) -> ModuleType:
    """Import a command's module, and with it all that makes a start slow."""
    return importlib.import_module(f"tactorch.cli.{_MODULES.get(verb, verb).replace(' ', '.')}")


def _conf() -> str:
    """The settings' place as Hydra wants it."""
    installed = importlib.util.find_spec(PACKAGE) is not None
    return f"pkg://{PACKAGE}" if installed else os.fspath(conf_folder())


@contextmanager
def _process_of(verb: str, settings: Sequence[str]) -> Iterator[None]:
    """Give Hydra the command line it reads, and errors to us instead of printing them."""
    arguments, debug = sys.argv, os.environ.get(_DEBUG)
    sys.argv, os.environ[_DEBUG] = [f"tactorch {verb}", *settings], "1"
    try:
        yield
    finally:
        sys.argv = arguments
        os.environ.pop(_DEBUG)
        if debug is not None:
            os.environ[_DEBUG] = debug


@contextmanager
def _no_lines_in_the_bar() -> Iterator[None]:
    """Where a progress bar shows the iterations, keep their lines to the log file."""
    handlers = [h for h in logging.getLogger().handlers if not isinstance(h, logging.FileHandler)]
    if not (is_rich(sys.stderr) and is_rich()):
        handlers = []
    for handler in handlers:
        handler.addFilter(_is_not_iteration)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(_is_not_iteration)


def _is_not_iteration(record: logging.LogRecord) -> bool:
    return record.name != "tactorch.inverse.monitor" or record.levelno > logging.INFO


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings of ours as their message alone, on the terminal and in the log."""
    usual: Callable[..., None] = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if category is UserWarning:
            logging.getLogger("tactorch").warning("warning: %s", message)
        else:
            usual(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
