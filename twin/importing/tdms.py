"""TDMS of LabVIEW and DIAdem, through npTDMS: one table per group, units and rate from the channels' properties."""

import logging
from pathlib import Path

import numpy as np

from twin.importing.tables import Channel, Table, library


class _Doubts(logging.Handler):
    """What the library only warns of, a file cut short or of another version, is an error."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            raise ValueError(record.getMessage())


def read(path: Path) -> list[Table]:
    """A table per group."""
    nptdms = library("nptdms")
    logs = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.startswith("nptdms")]
    before = [log.handlers for log in logs]
    for log in logs:
        log.handlers = [_Doubts()]
    try:
        file = nptdms.TdmsFile.read(path)
    finally:
        for log, handlers in zip(logs, before, strict=True):
            log.handlers = handlers
    tables = []
    for group in file.groups():
        channels, rate = {}, None
        for channel in group.channels():
            values = np.asarray(channel[:])
            if values.dtype.kind in "iuf" and values.size:
                channels[channel.name] = Channel(values, str(channel.properties.get("unit_string", "")))
                if step := channel.properties.get("wf_increment"):
                    rate = 1 / float(step)
        tables.append(Table(f"{path.stem}.{group.name}", channels, rate))
    return tables
