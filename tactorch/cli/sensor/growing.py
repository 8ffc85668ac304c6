"""A recording that grows contact by contact, for `tactorch live` to follow."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tactorch.cli.settings import log
from tactorch.errors import ConfigError
from tactorch.recording import Recording, append_press, compact


def grow(contacts: Iterable[Recording], out: Path) -> Path:
    """Append the presses of contacts to a recording as they come; Ctrl-C ends it.

    Raises:
        ConfigError: The recording is there already, or no press came.
    """
    if out.exists():
        raise ConfigError(f"out={out} is there already; choose another, or move it away.")
    count = 0
    try:
        for contact in contacts:
            for index, press in enumerate(contact.presses):
                if count:
                    append_press(out, press)
                else:
                    contact.select([index]).save(out)
                count += 1
            strongest = max(float(np.linalg.norm(p.total_force)) for p in contact.presses)
            log.info(
                "%s: %d presses up to %.3g N; %d in '%s'",
                contact.presses[0].name.partition(",")[0], len(contact.presses), strongest, count,
                out,
            )  # fmt: skip
    except KeyboardInterrupt:
        log.info("ended by Ctrl-C")
    if not count:
        raise ConfigError(
            "no contact became presses; see what was told of them, or look at the frames with"
            " tactorch sensor track."
        )
    compact(out)
    log.info("recording: %s", out)
    return out
