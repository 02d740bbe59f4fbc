"""The public names and the verbs are the recorded ones; run as a script, this records them."""

import inspect
from pathlib import Path

import farfield
from farfield.calibration.solving import CalibrationOptions
from farfield.cli import VERBS
from farfield.cli._completion import flags_of
from farfield.simulation.recording import RecordingOptions

SNAPSHOT = Path(__file__).with_name("public_api.txt")


def _public_api() -> str:
    lines = [f"verb {verb} {' '.join(sorted(flags_of(verb)))}" for verb in sorted(VERBS)]
    for name in sorted(farfield.__all__):
        thing = getattr(farfield, name)
        exception = inspect.isclass(thing) and issubclass(thing, Exception)
        names = "" if exception else ", ".join(inspect.signature(thing).parameters)
        lines.append(f"{'class' if inspect.isclass(thing) else 'def'} {name}({names})")
    keywords = (CalibrationOptions, RecordingOptions)  # of calibrate and simulate
    lines += [f"options {kind.__name__}({', '.join(inspect.signature(kind).parameters)})" for kind in keywords]
    return "\n".join(lines) + "\n"


def test_public_api_is_the_recorded_one() -> None:
    message = (
        "the public API changed: if that is meant, run `python tests/api/test_public_api.py` and add a line to "
        "CHANGELOG.md; a removed or renamed parameter breaks users"
    )
    assert _public_api() == SNAPSHOT.read_text(encoding="utf-8"), message


if __name__ == "__main__":
    SNAPSHOT.write_text(_public_api(), encoding="utf-8")
