"""Take the pictures of docs/studio.md in a browser:  python benchmarks/studio_pictures.py [NAME[=DATA]] ...

NAME is annotate, radar, patterns, camera, night, calibrate_radar or calibrate_camera; all unless given. DATA is a data
set's folder, perhaps with the number of a frame (DATA:3); without it the frames are simulated. With DATA the picture
goes to data/studio-pictures/, as real frames must not be shown in the docs: their licences do not allow it. Needs the
studio extra, Playwright and a Chromium, see `make test-browser`.
"""

import subprocess
import sys
from io import BytesIO
from pathlib import Path

from _report import ROOT
from _studio_process import started
from _studio_screen import Screen, chromium_path, screen
from PIL import Image


def annotate(page: Screen) -> None:
    """A vehicle with its close-ups."""
    rows = [row for row in page.boxes if 12 < row["distance_m"] < 40]
    row = max(rows, key=lambda one: one["points"] or 0)
    page.look(*row["box"][:2], 30, top=False)
    page.click(row["box"][:3])


def radar(page: Screen) -> None:
    """The radar's map alone, from above, with the boxes; the slice of one of them beside it."""
    far = [row for row in page.boxes if 25 < row["distance_m"] < 60 and abs(row["box"][1]) < 12]
    row = max(far, key=lambda one: one["radar_points"] or one["points"] or 0)
    page.look(*row["box"][:2], 30)
    page.click(row["box"][:3])
    for name in ("os2-64", "os1-128"):
        page.page.locator(f"#left input[name='layer {name}']").first.click()
    page.look(34, 0, 62)


def patterns(page: Screen) -> None:
    """The first two clouds side by side."""
    page.press("Backslash")
    page.settled()
    sides = page.page.locator("#left .layer:has(input[type=range]) button")
    sides.nth(0).click()
    sides.nth(1).click()
    sides.nth(1).click()
    page.tell("look([45, 0, 0], 80, true)")


def camera(page: Screen) -> None:
    """Points and boxes in a large picture."""
    page.page.locator(".camera canvas").first.click()
    page.tell("look([20, 0, 0], 38, false)")


def calibrate_radar(page: Screen) -> None:
    """The radar put elsewhere by typed numbers, then solved."""
    for name, value in (("x_m", "-1.7"), ("y_m", "-0.3"), ("yaw_rad", "1.5")):
        page.page.locator(f"input[name='{name}']").fill(value)
        page.press("Enter")
    page.page.get_by_role("button", name="Refine").click()
    page.until("is(({ model }) => model.state.solved !== '' && model.fresh)", seconds=300)


def calibrate_camera(page: Screen) -> None:
    """Pairs picked in the picture and the cloud, then the camera turned away from them."""
    page.press("n")
    rows = page.tell("spread(9)")
    for number, (point, pixel) in enumerate(rows, 1):
        page.page.mouse.click(*page.tell(f"pixel({pixel})"))
        page.page.mouse.click(*page.tell(f"strip({point})"))
        page.until(f"is(({{ model }}) => model.state.picks.length === {number})")
    page.press("Escape")
    for name, value in (("moved0", "0.5"), ("moved1", "-0.6"), ("moved2", "0.4")):
        page.page.locator(f"input[name='{name}']").fill(value)
        page.press("Enter")
    page.until("is(({ model }) => model.fresh)")


SCENES = {"annotate": annotate, "radar": radar, "patterns": patterns, "camera": camera, "night": camera}
CALIBRATIONS = {"calibrate_radar": "radar-lidar", "calibrate_camera": "lidar-camera"}
SCENES |= {"calibrate_radar": calibrate_radar, "calibrate_camera": calibrate_camera}
_RADAR = ("kradar-sim", "--frames", "1", "--sequences", "1", "--sensors", "os2-64,os1-128,cam-front,polar3d")
SIMULATED = {
    "annotate": _RADAR,
    "radar": _RADAR,
    "patterns": ("cirrus-sim", "--frames", "1", "--sequences", "1"),
    "camera": ("kitti-sim", "--frames", "1", "--sequences", "1"),
    "night": (*_RADAR, "--weather", "rain", "--time", "night"),
    "calibrate_radar": ("kradar-sim-mini", "--frames", "20", "--sequences", "1", "--sensors", "os2-64,sparse,cells"),
    "calibrate_camera": ("kitti-sim", "--frames", "8", "--sequences", "1"),
}
WORK = ROOT / "data" / "studio-pictures"


def simulated(name: str) -> Path:
    """The frame of a picture; what is there already stays."""
    preset, *arguments = SIMULATED[name]
    folder = WORK / ("-".join([preset, *arguments[4 if name in CALIBRATIONS else 6 :]]).replace("--", ""))
    command = [sys.executable, "-m", "farfield.cli", "simulate", preset, str(folder), *arguments]
    subprocess.run([*command, "--workers", "1"], check=True, stdout=subprocess.DEVNULL)
    return folder


def take(name: str, source: str) -> Path:
    """One picture."""
    from playwright.sync_api import sync_playwright

    folder, _, frame = source.partition(":")
    kept = WORK if source else ROOT / "docs" / "images"
    folder = folder or str(simulated(name))
    mode = "annotate" if name in ("annotate", "radar") else "view"
    place = kept / f"studio_{name}.png"
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=chromium_path())
        edits = str(WORK / f"{name}-{Path(folder).name}-edits")  # a journal is of one data set
        more = ("--extent", "full", "--edits", edits) if mode == "annotate" else ()
        verb = ("calibrate", CALIBRATIONS[name]) if name in CALIBRATIONS else (mode,)
        more = ("--page", "--frames", "20") if name in CALIBRATIONS else more
        with (
            started(*verb, *(() if folder == "samples" else (folder,)), *more) as live,
            screen(chromium, live, frame=int(frame or 0)) as page,
        ):
            SCENES[name](page)
            page.settled()
            page.page.wait_for_timeout(5000)
            picture = Image.open(BytesIO(page.page.screenshot())).convert("RGB")
        chromium.close()
    place.parent.mkdir(parents=True, exist_ok=True)
    picture.quantize(256, dither=Image.Dither.NONE).save(place, optimize=True)
    return place


def main() -> None:
    """Take those that are asked for."""
    for argument in sys.argv[1:] or SCENES:
        name, _, source = argument.partition("=")
        place = take(name, source)
        print(f"{place.relative_to(ROOT)}: {place.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
