"""Rates of a machine that does not exist, with round numbers: what comes of them can be worked out by hand."""

from typing import Any

from farfield.sizing import MachineRates, MeasuredRate


def rate(name: str, seconds: float, *, frames_of: str = "kradar", **fields: Any) -> MeasuredRate:
    tree = {"name": name, "kind": "verb", "frames_of": frames_of, "seconds": [seconds], **fields}
    return MeasuredRate.model_validate(tree)


def machine(*rates: MeasuredRate, **fields: Any) -> MachineRates:
    tree: dict[str, Any] = {
        "version": "0",
        "date": "2026-01-01 00:00 UTC",
        "processor": "a processor",
        "cores": 4,
        "two_at_once": 0.8,
        "sizes": {
            "cirrus": {"cloud": 2e6, "clouds": 4e6, "camera": 1e5, "cameras": 1e5, "labels": 1e4},
            "kradar": {"cloud": 7e6, "cells": 3e5, "tesseract": 260e6, "labels": 1e3},
        },
    }
    return MachineRates(**(tree | fields), rates=rates)
