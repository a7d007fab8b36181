"""TDMS of LabVIEW and DIAdem, through npTDMS: one table per group, units and rate from the channels' properties."""

from pathlib import Path

import numpy as np

from twin.importing.tables import Channel, Table, library


def read(path: Path) -> list[Table]:
    """A table per group."""
    tables = []
    for group in library("nptdms").TdmsFile.read(path).groups():
        channels, rate = {}, None
        for channel in group.channels():
            values = np.asarray(channel[:])
            if values.dtype.kind in "iuf" and values.size:
                channels[channel.name] = Channel(values, str(channel.properties.get("unit_string", "")))
                if step := channel.properties.get("wf_increment"):
                    rate = 1 / float(step)
        tables.append(Table(f"{path.stem}.{group.name}", channels, rate))
    return tables
