"""The numbers of the decision, of ``calibration.yaml``."""

from functools import cache
from pathlib import Path

from twin.yamlfile import read_yaml


@cache
def calibration() -> dict[str, float]:
    """Name → number."""
    return {key: float(value) for key, value in read_yaml(Path(__file__).with_name("calibration.yaml")).items()}
