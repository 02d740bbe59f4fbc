"""A trained detector as one ONNX file with its card, compared with the network on five clouds before it is written."""

import hashlib
import json
import logging
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from farfield.detectors.exporting.card import card_text
from farfield.detectors.exporting.clouds import checked_clouds
from farfield.detectors.exporting.graphs import Graph
from farfield.detectors.exporting.parity import (
    PARITY,
    SAME_M,
    SAME_RAD,
    SAME_SHARE,
    CloudParity,
    ask,
    blank_inputs,
    compared,
    filled,
)
from farfield.detectors.exporting.plans import plan_of
from farfield.detectors.onnx.detector import OnnxDetector
from farfield.detectors.onnx.readings import Reading, Tensors
from farfield.detectors.onnx.record import PROVENANCE, RECORD, UNITS, OnnxRecord
from farfield.detectors.runtime import Detector
from farfield.detectors.trained import cloud_rows
from farfield.errors import ConfigError, FarfieldError, MissingExtraError
from farfield.files.atomic import write_bytes, write_text
from farfield.frame import Cloud

OPSET = 20


@dataclass(frozen=True)
class OnnxExport:
    """What was written.

    Args:
        path: The file.
        card: The card beside it.
        parity: Of each cloud.
        seconds: How long it took.
        size: Bytes of the file.
    """

    path: Path
    card: Path
    parity: tuple[CloudParity, ...]
    seconds: float
    size: int


def export(
    detector: Detector, path: Path, *, licence: str = "", clouds: Mapping[str, Cloud] | None = None
) -> OnnxExport:
    """Write a detector as an ONNX file with its card; nothing is left where file and network do not agree.

    Args:
        detector: On the CPU, in fp32; its thresholds become those of the file.
        path: Target, ``.onnx``.
        licence: Under which the weights may be used.
        clouds: On which file and network are compared (default: five made ones).

    Raises:
        ConfigError: If the detector is not exported, or not on the CPU in fp32.
        FarfieldError: If the file does not agree with the network.
        MissingExtraError: If onnx, onnxscript or onnxruntime is not installed.
    """
    start = time.perf_counter()
    _check_packages()
    if path.suffix != ".onnx":
        raise ConfigError(f"Expected a target that ends in .onnx, got {path}.")
    if detector.precision != "fp32" or detector.device.type != "cpu" or detector.chosen is not None:
        raise ConfigError(f"{detector.name}: expected fp32 on cpu and all classes to export; load it so.")
    reading, graph = plan_of(detector.network)
    config = detector.config
    heights = getattr(config.grid, "z_min_m", -6.0)
    clouds = clouds or checked_clouds(detector.columns, detector.reach_m, config.grid.half_width_m, heights)
    record = _record(detector, reading, licence)
    usual = cloud_rows(clouds["usual"], reading.columns)
    data = _with_record(_onnx(graph, _sample(reading, graph, usual)), record, detector.provenance)
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / path.name
        trial.write_bytes(data)
        written = OnnxDetector(trial, score_threshold=config.score_threshold)
        plainly = OnnxDetector(trial, optimised=False)
        parity = tuple(compared(name, cloud, detector, graph, (written, plainly)) for name, cloud in clouds.items())
    failed = [row for row in parity if not row.holds]
    seconds = time.perf_counter() - start
    if failed:
        worst = "; ".join(f"{row.cloud}: {row.largest:.1e}, {row.same:.2%} of {row.boxes} boxes" for row in failed)
        raise FarfieldError(
            f"{path}: expected outputs within {PARITY:g} of the network's and {SAME_SHARE:.1%} of its boxes within "
            f"{SAME_M * 1000:g} mm and {SAME_RAD:g} rad, got {worst}. Nothing was written."
        )
    write_bytes(path, data)
    card = path.with_suffix(".md")
    write_text(card, card_text(record, detector.provenance, parity, size=len(data)))
    return OnnxExport(path, card, parity, seconds, len(data))


def _check_packages() -> None:
    for package in ("onnx", "onnxscript", "onnxruntime"):
        try:
            __import__(package)
        except ModuleNotFoundError as error:
            raise MissingExtraError(package, "export", "Exporting a detector") from error


def _record(detector: Detector, reading: Reading, licence: str) -> OnnxRecord:
    config = detector.config
    digest = hashlib.sha256()
    for name, values in detector.network.state_dict().items():
        digest.update(f"\0{name}\0{tuple(values.shape)}".encode())
        digest.update(values.detach().contiguous().numpy().tobytes())
    import onnx
    import onnxscript

    import farfield

    made_with = {"torch": torch.__version__, "onnx": onnx.__version__, "onnxscript": onnxscript.__version__}
    return OnnxRecord(
        farfield=farfield.__version__,
        name=detector.name,
        detector=config.name,
        network=detector.network_name,
        classes=detector.class_names,
        units={name: UNITS.get(name, "as the cloud's column has it") for name in reading.columns},
        reference=detector.reference,
        reach_m=detector.reach_m,
        score_threshold=config.score_threshold,
        nms_iou=config.nms_iou,
        max_boxes=config.max_boxes,
        score_bands=config.score_bands,
        weights_sha256=digest.hexdigest(),
        licence=licence,
        opset=OPSET,
        made_with=made_with,
        reading=reading,
    )


def _sample(reading: Reading, graph: Graph, points: np.ndarray) -> dict[str, torch.Tensor]:
    """Inputs of both halves of a graph, as a usual cloud makes them."""
    notes: list[Tensors] = []
    blank = blank_inputs(reading, graph)
    reading.detect(points, partial(ask, graph, blank, notes))
    joined: dict[str, np.ndarray] = {}
    for tensors in notes:
        joined |= tensors
    return {name: torch.from_numpy(values) for name, values in sorted(filled(joined, blank).items())}


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence what the exporter says of its own workings."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _onnx(graph: Graph, sample: dict[str, torch.Tensor]) -> bytes:
    """The bytes of the model: one file, standard operators alone."""
    import onnx

    dynamic = {name: {0: torch.export.Dim.DYNAMIC} for name in sample}
    with _quiet(), torch.no_grad():
        program = torch.onnx.export(
            graph,
            (),
            kwargs={"inputs": sample},  # a dict at the end of the arguments would be taken for them
            dynamo=True,
            dynamic_shapes={"inputs": dynamic},
            input_names=list(sample),
            output_names=list(graph.outputs),
            opset_version=OPSET,
            external_data=False,
            verbose=False,
            optimize=False,
        )
        assert program is not None
        _simplify(program.model)
    model = program.model_proto
    for value in (*model.graph.input, *model.graph.output):
        del value.metadata_props[:]
    for node in model.graph.node:
        del node.metadata_props[:]  # places in sources of this machine
        node.doc_string = ""
    del model.graph.value_info[:]
    del model.graph.metadata_props[:]
    del model.metadata_props[:]
    domains = {node.domain for node in model.graph.node} | {""}
    for index in reversed(range(len(model.opset_import))):
        if model.opset_import[index].domain not in domains:
            del model.opset_import[index]
    model.producer_name = "farfield"
    onnx.checker.check_model(model, full_check=False)
    return bytes(model.SerializeToString())


def _simplify(model: Any) -> None:
    """Fold constants and drop what is not needed or stands twice.

    The exporter's own optimiser also looks for some hundred patterns at each of thousands of operators, which takes
    longer than all else of an export; onnxruntime fuses what can be fused when it loads the file.
    """
    from onnx_ir.passes import common
    from onnxscript import optimizer

    common.InlinePass()(model)
    optimizer.fold_constants(model)
    common.RemoveUnusedNodesPass()(model)
    common.RemoveUnusedFunctionsPass()(model)
    common.RemoveUnusedOpsetsPass()(model)
    common.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
    common.DeduplicateInitializersPass()(model)
    common.CommonSubexpressionEliminationPass()(model)


def _with_record(data: bytes, record: OnnxRecord, provenance: Mapping[str, Any]) -> bytes:
    import onnx

    model = onnx.load_model_from_string(data)
    texts = {RECORD: record.model_dump_json(), PROVENANCE: json.dumps(provenance)}
    onnx.helper.set_model_props(model, texts)
    return bytes(model.SerializeToString())
