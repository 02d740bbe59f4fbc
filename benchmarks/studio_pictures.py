"""Take the pictures of docs/studio.md in a browser:  python benchmarks/studio_pictures.py NAME=DATA ...

NAME is annotate, radar, patterns, camera or night; DATA a data set's folder, perhaps with the number of a frame
(DATA:3). Needs the studio extra, Playwright and a Chromium, see `make test-browser`.
"""

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
    """The radar's map under the cloud, its slice beside the close-ups."""
    annotate(page)
    page.tell("look([28, 0, 0], 48, false)")


def patterns(page: Screen) -> None:
    """The first two clouds side by side."""
    page.press("Backslash")
    page.settled()
    sides = page.page.locator("#left .layer:has(input[type=range]) button")
    sides.nth(0).click()
    page.page.locator("#left .layer:has(input[type=range]) button").nth(1).click()
    page.page.locator("#left .layer:has(input[type=range]) button").nth(1).click()
    page.tell("look([30, 0, 0], 60, true)")


def camera(page: Screen) -> None:
    """Points and boxes in a large picture."""
    page.page.locator(".camera canvas").first.click()
    page.tell("look([20, 0, 0], 38, false)")


SCENES = {"annotate": annotate, "radar": radar, "patterns": patterns, "camera": camera, "night": camera}


def take(name: str, source: str) -> Path:
    """One picture."""
    from playwright.sync_api import sync_playwright

    folder, _, frame = source.partition(":")
    mode = "annotate" if name in ("annotate", "radar") else "view"
    place = ROOT / "docs" / "images" / f"studio_{name}.png"
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=chromium_path())
        edits = str(ROOT / "data" / "studio-pictures" / name)
        more = ("--extent", "full", "--edits", edits) if mode == "annotate" else ()
        with (
            started(mode, *(() if folder == "samples" else (folder,)), *more) as live,
            screen(chromium, live, frame=int(frame or 0)) as page,
        ):
            SCENES[name](page)
            page.settled()
            page.page.wait_for_timeout(5000)
            picture = Image.open(BytesIO(page.page.screenshot())).convert("RGB")
        chromium.close()
    picture.quantize(256, dither=Image.Dither.NONE).save(place, optimize=True)
    return place


def main() -> None:
    """Take those that are asked for."""
    for argument in sys.argv[1:]:
        name, _, source = argument.partition("=")
        place = take(name, source)
        print(f"{place.relative_to(ROOT)}: {place.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
