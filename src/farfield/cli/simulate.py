"""``farfield simulate``: write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE."""

from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from farfield.cli._output import bar, check_outputs
from farfield.simulation.recording import RecordingOptions, record

AS_IT_IS = RecordingOptions()


def run(
    preset: tyro.conf.Positional[str],
    out: tyro.conf.Positional[Path],
    /,
    options: Annotated[RecordingOptions, tyro.conf.arg(name="")] = AS_IT_IS,
) -> int:
    """Write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE.

    examples:
      farfield simulate cirrus-sim data/sim --frames 100
      farfield simulate cirrus-sim data/snow --frames 100 --weather heavy_snow --sensors gaussian,uniform
      farfield simulate cirrus-sim-highway data/highway --frames 200 --sequences 40 --seed 3 --workers 4 --cache
      farfield simulate kradar-sim data/kradar --frames 116 --sensors os2-64,sparse,cam-front
      farfield simulate kradar-sim-mini data/mini
      farfield simulate radiate-sim data/radiate --frames 160 --traffic right
      farfield simulate cirrus-sim-val-v2 data/val
      farfield simulate cirrus-sim data/raw --recording --frames 600 --sequences 1

    An interrupted run resumes: a frame's files appear whole or not at all. Results do not depend on the number of
    workers. A frozen preset (cirrus-sim-val-v2) is compared with its recorded checksums; exit status 1 if a frame
    differs.

    Args:
        preset: cirrus-sim (two scan patterns and a camera, highway and town in turn), cirrus-sim-ideal (patterns taken
            at the same moment), cirrus-sim-highway, cirrus-sim-urban, cirrus-sim-varied (many roads, sensor mountings
            and size priors, to train on), cirrus-sim-val-v2 (frozen), cirrus-sim-val-v3 (its
            roads in world v3), kradar-sim (58 sequences in seven weathers: two Ousters, 4D radar, stereo cameras),
            kitti-sim (64 beams, full bodies, annotated in the camera's field), radiate-sim (a turning radar, four
            pictures a second, traffic on the left), cirrus-sim-mini, kradar-sim-mini, kitti-sim-mini, radiate-sim-mini.
        out: Folder to write into; made if absent. Cirrus frames go to Cirrus_dataset1 below it, K-Radar's to 1, 2, ...
        options: What is changed of it, and who works.
    """
    check_outputs((), folders={"out": out})
    if options.recording:
        from farfield.simulation.recording.raw import record_streams

        chosen = vars(options) | {"sweeps": options.frames}
        del chosen["frames"], chosen["recording"]
        record_streams(preset, out, **chosen, progress=partial(bar, what="recording", transient=True), report=print)
        return 0
    progress = partial(bar, what="simulating", transient=True)
    return int(record(preset, out, **vars(options), progress=progress, report=print).different > 0)
