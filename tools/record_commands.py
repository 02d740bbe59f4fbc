"""The commands that are recorded: every verb, on small simulated data and on real frames where there are some.

What is left out, and why: ``reproduce`` trains for hours at its smallest, so that only its plans are recorded (not
``--plan`` itself, which measures this machine); ``detectors --measure`` and the studio's speeds are measurements; a
radar's tesseract has 260 MB a frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass

_METHODS = ("range", "paired", "unpaired", "device", "continued")
_REAL: tuple[str, ...] = (
    "kitti",
    "kitti_more",
    "kitti_raw",
    "view_of_delft",
    "argoverse2",
    "radiate",
    "astyx",
    "tj4dradset",
)
_REAL += ("cirrus_layout", "sustechpoints", "pandaset", "pcd", "argoverse2_tracks")
_VERBS = (
    *("demo", "doctor", "stats", "radar", "show", "view", "annotate", "new-dataset", "simulate", "convert"),
    *(
        "formats",
        "detectors",
        "experiments",
        "bench",
        "train",
        "adapt",
        "reproduce",
        "import-weights",
        "predict",
        "evaluate",
        "track",
    ),
    *("sync", "calibrate", "odometry", "anonymize", "depth", "score", "compare-results", "compare", "report"),
)
_VARIANTS = (
    *("old_as_shipped", "old_yaw_fixed", "revised_as_shipped", "revised_yaw_fixed@0.3", "old_as_shipped@0.5"),
    *("revised_as_shipped@0.7", "rtnh_narrow", "rtnh_wide", "lidar_wide", "asf_narrow", "asf_wide"),
)
_EXPERIMENTS = ("pointpillars-cirrus-sim", "rtnh-kradar-sim", "voxelnet-kitti", "rtnx101-kradar", "sparsecentre-cirrus")
_ON_CPU = "--precision fp32 --device cpu --workers 1"


@dataclass(frozen=True)
class Step:
    """Commands of one folder.

    Args:
        name: Its name.
        commands: What is run, one after the other: ``farfield VERB ...``, a script of this folder with its words, or
            ``tree FILE ...``, which copies files of the sources' tree.
        takes: Steps whose folders are copied first.
        real: Real frames that are copied into ``real`` first, as patterns below their folder.
        limit_s: A command that takes longer is killed.
        varies: Patterns of files that are other ones each time by intent; it is recorded that they are written.
    """

    name: str
    commands: tuple[str, ...]
    takes: tuple[str, ...] = ()
    real: tuple[str, ...] = ()
    limit_s: float = 240.0
    varies: tuple[str, ...] = ()


def _step(name: str, *commands: str, takes: str = "", real: str = "", limit_s: float = 240.0) -> Step:
    return Step(name, commands, tuple(takes.split()), tuple(real.split()), limit_s)


def _words() -> Iterator[Step]:
    """Helps, lists, and what is said of wrong words."""
    yield _step("help", "farfield --help", "farfield", "farfield --completion bash", "farfield --completion zsh")
    for verb in _VERBS:
        yield _step(f"help-{verb}", f"farfield {verb} --help")
    yield _step("lists", "farfield detectors --json detectors.json", "farfield detectors --cloud uniform --epsilon 0")
    yield _step("experiments", "farfield experiments", *(f"farfield experiments {name}" for name in _EXPERIMENTS))
    yield _step(
        "wrong",
        *("farfield no-such-verb", "farfield --completion none", "farfield doctor nowhere", "farfield doctor"),
        *("farfield simulate none out", "farfield train none", "farfield experiments none", "farfield predict none x"),
        *("farfield score a.csv b.csv", "farfield convert nowhere out --to kitti", "farfield report nowhere"),
        *("farfield evaluate none nowhere", "farfield track nowhere --out x.csv", "farfield stats . --format none"),
    )
    yield _step("protocol-ts", "tree web/src/protocol.ts src/farfield/studio/static/index.html")
    yield _step("inputs", *(f"record_inputs.py {kind}" for kind in ("clouds", "stamps", "experiments", "photos")))


def _simulated() -> Iterator[Step]:
    """Every preset, small."""
    one = "--workers 1"
    yield _step(
        "cirrus",
        f"farfield simulate cirrus-sim-mini cirrus --frames 6 --sequences 2 --sensors gaussian,uniform,camera {one}",
        f"farfield simulate cirrus-sim-mini cirrus --frames 6 --sequences 2 --sensors gaussian,uniform,camera {one}",
    )
    sensors = "os2-64,cells,cam-front,sparse"
    yield _step(
        "kradar", f"farfield simulate kradar-sim-mini kradar --frames 6 --sequences 2 --sensors {sensors} {one}"
    )
    yield _step(
        "drive", f"farfield simulate kradar-sim-mini drive --frames 12 --sequences 1 --sensors os2-64,sparse {one}"
    )
    yield _step(
        "cube",
        "farfield simulate kradar-sim-mini cube --frames 1 --sequences 1 --weather sleet "
        f"--sensors os2-64,cam-front,polar3d,cube,cells {one}",
    )
    yield _step(
        "pair",
        f"farfield simulate kradar-sim-mini pair --frames 2 --sequences 1 --sensors os2-64,os1-128,cam-right {one}",
    )
    yield _step("kitti", f"farfield simulate kitti-sim-mini kitti --frames 4 --sequences 2 {one}")
    yield _step("radiate", f"farfield simulate radiate-sim-mini radiate --frames 3 --sequences 1 --traffic right {one}")
    yield _step("raw", f"farfield simulate cirrus-sim raw --recording --frames 12 --sequences 1 {one}")
    for weather in ("overcast", "fog", "rain", "sleet", "light_snow", "heavy_snow"):
        yield _step(
            f"weather-{weather}",
            f"farfield simulate cirrus-sim-mini out --frames 1 --sequences 1 --weather {weather} --time night {one}",
        )
    for preset in ("ideal", "highway", "urban", "varied"):
        yield _step(
            f"preset-{preset}",
            f"farfield simulate cirrus-sim-{preset} out --frames 1 --sequences 1 --seed 5 --cache "
            f"--sensors gaussian,uniform {one}",
        )
    yield _step("preset-frozen", "farfield simulate cirrus-sim-val-v2 out --dry-run --workers 1")
    offset = "farfield simulate cirrus-sim-mini out --frames 3 --sequences 1 --uniform-offset-ms 40 --stride-s 0.2"
    offset += " --sensors uniform"
    yield _step(
        "offset",
        f"{offset} --workers 1 --dry-run",
        f"{offset} --workers 2",
    )
    yield _step(
        "own",
        "farfield new-dataset sweeps",
        "farfield doctor sweeps",
        "farfield score sweeps/detections.csv sweeps/labels.csv",
    )


def _looked_at() -> Iterator[Step]:
    """Doctor, statistics, comparisons, pictures, conversions, readers: of simulated data."""
    for name in ("cirrus", "kradar", "kitti", "radiate", "cube", "raw"):
        yield _step(
            f"look-{name}",
            f"farfield doctor {name} --json doctor.json --workers 1",
            f"farfield stats {name} --out stats --json - --workers 1",
            f"farfield show {name} --out shown.png",
            f"record_python.py frames {name}",
            takes=name,
        )
    yield _step(
        "look-own", "farfield doctor own", "farfield stats own --out stats", "farfield show own", takes="inputs"
    )
    yield _step("frames-radar", "record_python.py frames kradar reference=radar", takes="kradar")
    yield _step("calibration-doctor", "farfield doctor kradar --calibration 6 --workers 1", takes="kradar")
    yield _step(
        "show-radar", "farfield show kradar --radar --frame 1", "farfield show cube --radar", takes="kradar cube"
    )
    yield _step(
        "radar",
        "farfield radar cube --out radar",
        "farfield radar cube --cfar ordered-statistic --false-alarm 1e-8 --speed 10 --turn 2 --out other",
        "farfield radar cube --doppler peak --out peak",
        takes="cube",
    )
    yield _step(
        "compare",
        "farfield compare cirrus kitti --out clouds --workers 1",
        "farfield compare kradar cube --names two,one --out radar --json compared.json --workers 1",
        takes="cirrus kitti kradar cube",
    )
    formats = ("kitti", "boxes-csv labels.csv", "openlabel", "sustechpoints", "cvat", "cirrus")
    for name in ("cirrus", "kitti"):
        for words in formats:
            format, _, out = words.partition(" ")
            yield _step(
                f"convert-{name}-{format}",
                f"farfield convert {name} {out or 'out'} --to {format} --workers 1",
                f"farfield convert {name} {out or 'out'} --to {format} --workers 1 --verify",
                *([] if format in ("boxes-csv", "openlabel") else ["record_python.py frames out"]),
                takes=name,
            )
    yield _step(
        "convert-cache", "farfield convert cirrus --to cache --workers 1", "farfield doctor cirrus", takes="cirrus"
    )
    for name, words in (
        ("whole", "--region cube"),
        ("sparse", "--rate 0.2 --over region"),
        ("narrow", "--region narrow"),
    ):
        yield _step(
            f"convert-store-{name}",
            f"farfield convert cube store --to radar-store --workers 1 {words}",
            "farfield convert cube store --to radar-store --workers 1 --verify",
            "record_python.py frames store",
            takes="cube",
        )
    yield _step("convert-radar", "farfield convert kradar labels.csv --to boxes-csv --reference radar", takes="kradar")
    yield _step("convert-dry", "farfield convert own out --to kitti --dry-run", takes="inputs")
    yield _step("python-arrays", "record_python.py arrays")
    yield _step("python-refused", "record_python.py refused")
    yield _step("python-detecting", "record_python.py detecting", takes="cirrus")


def _detected() -> Iterator[Step]:
    """The shipped detectors, scores of every protocol, tracks, reports."""
    for name in ("pointpillars", "pointrcnn", "second", "sparsecentre", "voxelnet"):
        yield _step(
            f"predict-{name}", f"farfield predict {name}-cirrus-sim cirrus --out found.csv {_ON_CPU}", takes="cirrus"
        )
    for name in ("rtnh", "pointpillars"):
        yield _step(
            f"predict-{name}-kradar",
            f"farfield predict {name}-kradar-sim kradar --out found.csv {_ON_CPU} --reference radar",
            takes="kradar",
        )
    yield _step(
        "predict-words",
        f"farfield predict pointpillars-cirrus-sim own/000.npy {_ON_CPU} --score-threshold 0.3",
        f"farfield predict pointpillars-cirrus-sim own --out found.csv {_ON_CPU} --rotate-deg 180 --picture first.png",
        "farfield predict pointpillars-cirrus-sim own --out bf16.csv --precision bf16 --device cpu --workers 2",
        takes="inputs",
    )
    yield _step(
        "predict-formats",
        f"farfield predict pointpillars-cirrus-sim cirrus --out results --format kitti --cloud uniform {_ON_CPU}",
        f"farfield predict pointpillars-cirrus-sim cirrus --out results.json --classes vehicle:Car,bicycle {_ON_CPU}",
        f"farfield predict pointpillars-cirrus-sim cirrus --out found.csv --dry-run {_ON_CPU}",
        "farfield show cirrus --detector pointpillars-cirrus-sim --frame 1 --max-boxes 20 --out shown.png",
        takes="cirrus",
    )
    evaluate, cirrus = "farfield evaluate pointpillars-cirrus-sim cirrus", "predict-pointpillars"
    yield _step(
        "evaluate",
        f"{evaluate} --replicates 20 --out dds {_ON_CPU}",
        f"{evaluate} --replicates 20 --out dds --range-bins-m 0,50,250 {_ON_CPU}",
        f"{evaluate} --protocol nuscenes --replicates 20 --out nuscenes --clouds gaussian --no-report {_ON_CPU}",
        f"{evaluate} --protocol kitti --out kitti --clouds uniform --json - --no-report {_ON_CPU}",
        f"{evaluate} --dry-run {_ON_CPU}",
        takes="cirrus",
    )
    yield _step(
        "evaluate-kradar",
        f"farfield evaluate rtnh-kradar-sim kradar --replicates 20 --out rtnh {_ON_CPU}",
        f"farfield evaluate pointpillars-kradar-sim kradar --region narrow --replicates 20 --out lidar {_ON_CPU}",
        "farfield compare-results rtnh lidar",
        "farfield compare-results rtnh lidar --separate",
        "farfield compare-results rtnh lidar --by weather --separate --names radar,lidar",
        "farfield compare-results rtnh --paper",
        takes="kradar",
    )
    for name in ("dds", "nuscenes", "kitti"):
        yield _step(
            f"score-{name}",
            f"farfield score found.csv cirrus --protocol {name} --replicates 50 --json {name}.json",
            f"farfield score found.csv cirrus --protocol {name} --label vehicle --range-bins-m 0,40,90 --replicates 0",
            f"farfield report {name}.json --out {name}.html --title Scores",
            takes=cirrus,
        )
    yield _step(
        "score-options",
        "farfield score found.csv cirrus --options ap=area distance=bev min_points=5 --epsilons 0,0.01 --region range",
        "farfield score found.csv cirrus --protocol none",
        "farfield score found.csv labels.csv --replicates 10",
        "farfield score found.csv cirrus --json -",
        takes=f"{cirrus} convert-cirrus-boxes-csv",
    )
    for name in ("kradar", *(f"kradar-compat:{name}" for name in _VARIANTS)):
        yield _step(
            f"score-{name.replace(':', '-').replace('@', '-')}",
            f"farfield score found.csv kradar --protocol {name} --replicates 20 --json scores.json",
            takes="predict-rtnh-kradar",
        )
    yield _step(
        "score-kradar-words",
        "farfield score found.csv kradar --protocol kradar --conditions published --label-version v2.1 --region narrow "
        "--options classes=vehicle score_cut=0.3 --replicates 20",
        takes="predict-rtnh-kradar",
    )
    track = "farfield track found.csv --data cirrus"
    presets = ("unposed", "offline", "annotated", "ab3dmot", "ab3dmot-paper", "centerpoint", "simpletrack")
    yield _step(
        "track",
        f"{track} --out tracks.csv --picture trails.png",
        f"{track} --out smooth.csv --smooth --join-s 5 --least-score 0.2",
        *(f"{track} --out {preset}.csv --preset {preset}" for preset in presets),
        f"{track} --out kitti --to kitti-tracking -o max_age_s=1.5 -o min_hits=1",
        f"{track} --out nuscenes.json --to nuscenes",
        "farfield track found.csv --out constant.csv --step-s 0.25 --dry-run",
        "farfield score tracks.csv cirrus --protocol tracking --label vehicle --json tracking.json",
        "farfield score tracks.csv cirrus --protocol nuscenes-tracking --label vehicle --json nuscenes-tracking.json",
        takes=cirrus,
    )
    yield _step(
        "track-drive",
        f"farfield predict pointpillars-kradar-sim drive --out found.csv {_ON_CPU}",
        "farfield track found.csv --data drive --out tracks.csv --picture trails.svg",
        "farfield score tracks.csv drive --protocol tracking --replicates 20 --json tracking.json",
        "farfield odometry drive --out poses --no-backward --workers 1",
        "farfield track found.csv --data drive --poses poses --out placed.csv --smooth",
        takes="drive",
    )
    yield _step(
        "film",
        "farfield report cirrus --film short.gif --frames 2 --workers 1 --predictions found.csv",
        "farfield report kradar --film short.mp4 --frames 2 --workers 1 --reach-m 60",
        takes=f"{cirrus} kradar",
    )
    yield _step("demo", "farfield demo --frames 2 --sequences 1", "farfield demo --radar --dry-run", limit_s=400)


def _learnt() -> Iterator[Step]:
    """A short training of every detector and method, adaptation, plans of reproduction."""
    for name in ("pointpillars", "pointrcnn", "second", "sparsecentre", "voxelnet"):
        yield _step(f"train-{name}", f"farfield train {name}.yaml", takes="inputs cirrus")
    for name in ("rtn", "rtnh"):
        yield _step(f"train-{name}", f"farfield train {name}.yaml", takes="inputs kradar")
    yield _step(
        "train-longer",
        "farfield train pointpillars.yaml --dry-run",
        "farfield train pointpillars.yaml",
        "farfield train pointpillars.yaml -o training.steps=14",
        f"farfield evaluate runs/pointpillars cirrus --replicates 10 --out evaluation {_ON_CPU}",
        "farfield report runs/pointpillars --out course.html",
        takes="train-pointpillars",
    )
    yield _step("train-augmented", "farfield train augmented.yaml", takes="inputs cirrus")
    for name in _METHODS:
        yield _step(f"train-{name}", f"farfield train {name}.yaml", takes="train-pointpillars")
    yield _step("train-teacher", "farfield train teacher.yaml", takes="train-pointpillars")
    for name in ("range", "unpaired"):
        yield _step(f"train-{name}-sparse", f"farfield train {name}-sparsecentre.yaml", takes="inputs cirrus")
    yield _step(
        "train-shipped",
        "farfield train pointpillars-cirrus-sim -o data.path=drives -o training.steps=2 -o training.batch_size=1 "
        '-o data.simulate={"preset":"cirrus-sim-mini","sequences":2,"frames":4,"seed":4} '
        "-o training.workers=0 -o training.threads=1 -o training.precision=fp32",
    )
    adapt = "farfield adapt pointpillars-cirrus-sim cirrus --clouds uniform --source cirrus --steps 4 --workers 1"
    yield _step(
        "adapt",
        f"{adapt} --frames 4 --rounds 2 --labels cirrus --dry-run",
        f"{adapt} --frames 4 --rounds 2 --labels cirrus --out adapted",
        f"farfield predict adapted cirrus --out found.csv {_ON_CPU}",
        takes="cirrus",
        limit_s=400,
    )
    yield _step(
        "reproduce",
        "farfield reproduce cirrus --dry-run",
        "farfield reproduce kradar --dry-run",
        "farfield reproduce kradar --transfer --dry-run",
        "farfield reproduce cirrus --budget desk --dry-run",
    )
    yield _step(
        "import-weights",
        "record_inputs.py checkpoint",
        "farfield import-weights theirs.pth ours.safetensors --settings mine.yaml --every-key",
        "farfield import-weights more.pth more.safetensors --settings mine.yaml",
        "farfield import-weights more.pth more.safetensors --settings mine.yaml --allow-unknown",
        f"farfield predict ours.safetensors own --out found.csv --score-threshold 0 --max-boxes 30 {_ON_CPU}",
        takes="inputs",
    )


def _sensed() -> Iterator[Step]:
    """Times, calibration, odometry, depth, privacy."""
    yield _step(
        "sync",
        "farfield sync rig --to lidar --tolerance-ms 17 --out rig-out",
        "farfield sync raw --out raw-out",
        "farfield sync raw --stamp log --out log-out",
        "farfield sync cirrus --out cirrus-out",
        "farfield sync rig --dry-run",
        takes="inputs raw cirrus",
    )
    yield _step("calibrate-radar", "farfield calibrate radar-lidar drive --out out --save mine.json", takes="drive")
    yield _step(
        "calibrate-camera",
        "farfield calibrate lidar-camera kradar --camera cam-front --frames 3 --out out --save kradar",
        "farfield calibrate lidar-camera cirrus --guess-focal 1000 --position 1.5 0 0.2 --frames 3 --out guessed",
        takes="kradar cirrus",
    )
    yield _step("calibrate-lidar", "farfield calibrate lidar-lidar pair --frames 2 --out out", takes="pair")
    yield _step(
        "calibrate-board",
        "farfield calibrate board . --corners 9 6 --draw board.png",
        "record_inputs.py board",
        "farfield calibrate board pictures --out out --save intrinsics.json",
        "farfield calibrate board . --charuco --draw charuco.png",
    )
    yield _step(
        "odometry",
        "farfield odometry drive --out out --picture track.png --workers 1 --dry-run",
        "farfield odometry drive --out out --picture track.png --workers 1",
        "farfield odometry own --out own-out --turning clockwise --no-backward --workers 1",
        "farfield odometry raw --out raw-out --cloud uniform --no-backward --workers 1",
        takes="drive inputs raw",
    )
    yield _step(
        "depth",
        "farfield depth cirrus --out depth --uncertainty --picture first.png --workers 1",
        *(f"farfield depth cirrus --out {m} --method {m} --workers 1" for m in ("delaunay", "ip-basic", "nearest")),
        "farfield depth kradar --out kradar-depth --camera cam-front --max-uncertainty 2 --workers 1",
        takes="cirrus kradar",
    )
    yield _step(
        "anonymize",
        "farfield anonymize cirrus covered --workers 1 --dry-run",
        "farfield anonymize cirrus covered --workers 1",
        takes="cirrus",
    )


def _spoken() -> Iterator[Step]:
    """The studio over its wire."""
    view, annotate = "record_studio.py view looking", "record_studio.py annotate editing"
    yield _step(
        "studio-view", f"{view} cirrus --predictions found.csv --protocol dds", takes="predict-pointpillars inputs"
    )
    yield _step("studio-view-radar", f"{view} kradar --reference radar", takes="kradar inputs")
    yield _step("studio-samples", view, takes="inputs")
    yield _step(
        "studio-page",
        "farfield view cirrus --html two.html --frame 0,2 --predictions found.csv",
        takes="predict-pointpillars",
    )
    yield _step(
        "studio-annotate",
        f"{annotate} cirrus --annotator kim --predictions found.csv",
        takes="predict-pointpillars",
        limit_s=400,
    )
    yield _step("studio-annotate-write", f"{annotate} kradar --annotator kim --write", takes="kradar")
    yield _step(
        "studio-annotate-own",
        f"{annotate} sweeps --annotator kim --out saved --to boxes-csv --classes Car:4.6,1.9,1.7 --extent full",
        takes="own",
    )
    yield _step("studio-tracks", "record_studio.py annotate tracking drive --annotator kim", takes="drive")
    calibrate = "record_studio.py calibrate calibrating"
    yield _step("studio-calibrate-radar", f"{calibrate} radar-lidar drive --page --frames 12 --out out", takes="drive")
    yield _step(
        "studio-calibrate-camera",
        f"{calibrate} lidar-camera kradar --camera cam-front --page --frames 3 --out out",
        takes="kradar",
    )


def _real() -> Iterator[Step]:
    """Real frames, where there are some."""
    for name in _REAL:
        yield _step(
            f"real-{name}",
            f"farfield doctor real/{name} --workers 1 --frames 4",
            f"record_python.py frames real/{name}",
            f"farfield show real/{name} --out shown.png",
            f"farfield convert real/{name} labels.csv --to boxes-csv --workers 1",
            real=name,
        )
    yield _step(
        "real-stats",
        *(
            f"farfield stats real/{name} --sweeps 2 --out {name} --workers 1"
            for name in ("kitti_more", "view_of_delft")
        ),
        real="kitti_more view_of_delft",
    )
    yield _step(
        "real-detect",
        f"farfield evaluate pointpillars-cirrus-sim real/kitti --protocol kitti --out kitti {_ON_CPU}",
        f"farfield evaluate sparsecentre-cirrus-sim real/cirrus_layout --replicates 20 --out cirrus {_ON_CPU}",
        real="kitti cirrus_layout",
    )
    boxes, label = "real/kitti_tracking/detections_pointrcnn_car", "real/kitti_tracking/label"
    words = "--format kitti-tracking --label Car"
    for name in ("default", "ab3dmot", "centerpoint"):
        yield _step(
            f"real-track-{name}",
            f"farfield track {boxes} --format kitti-tracking --preset {name} --out tracks",
            f"farfield score tracks {label} --protocol tracking {words} --replicates 20 --json tracking.json",
            f"farfield score tracks {label} --protocol nuscenes-tracking {words} --json nuscenes.json",
            real="kitti_tracking",
        )
    yield _step(
        "real-score-nuscenes",
        f"farfield score {boxes} {label} --protocol nuscenes {words} --replicates 20 --json nuscenes.json",
        f"farfield score {boxes} {label} --protocol dds {words} --replicates 20 --json dds.json",
        real="kitti_tracking",
    )
    yield _step(
        "real-score-kradar",
        "record_inputs.py kit",
        *(
            f"farfield score {which}-pred.csv {which}-gt.csv --protocol {name} --replicates 5 --json {which}-{n}.json"
            for which in ("iso", "long")
            for n, name in enumerate(("kradar", *(f"kradar-compat:{name}" for name in _VARIANTS)))
        ),
        real="kradar/evaluation",
    )
    yield _step("real-calibrate", "farfield calibrate lidar-camera real/kitti --frames 3 --out out", real="kitti")
    yield _step("real-odometry", "farfield odometry real/kitti_raw --out out --workers 1", real="kitti_raw")
    yield _step("real-depth", "farfield depth real/kitti --out out --uncertainty --workers 1", real="kitti")
    yield _step(
        "real-sync",
        "farfield sync real/kitti_raw --out kitti",
        "farfield sync real/time --out time",
        real="kitti_raw time",
    )
    yield Step(
        "real-anonymize",
        (
            "farfield anonymize real/faces_and_plates covered --series single --workers 1",
            "farfield anonymize real/faces_and_plates pixels --series single --no-plates --how pixelate --workers 1",
        ),
        real=("faces_and_plates/grace_hopper.jpg", "faces_and_plates/rear_plate_cz.png"),
        varies=("pixels/*.jpg", "pixels/.journal.jsonl"),  # the cells' noise has a seed that nobody keeps
    )


STEPS: tuple[Step, ...] = (
    *_words(),
    *_simulated(),
    *_looked_at(),
    *_detected(),
    *_learnt(),
    *_sensed(),
    *_spoken(),
    *_real(),
)
"""All steps; each stands behind those that it takes."""
