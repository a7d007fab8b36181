"""Traces of KUKA's KRC: a DIAdem header (.dat) beside its numbers (.r64), 64-bit and little-endian, row by row.

Codes of the header as National Instruments documents them: 200 name, 202 unit, 210 implicit or explicit, 211 file. Of
the numbers: 213 BLOCK or CHANNEL, 214 REAL64, 220 count, 221 first value (from 1), 240 start or offset, 241 step or
factor.
"""

from pathlib import Path, PureWindowsPath

import numpy as np

from twin.errors import InputError
from twin.importing.tables import Channel, Table


def read(path: Path) -> list[Table]:
    """One table. A .dat that is no DIAdem header is a trace exported as text."""
    text = path.read_bytes().decode("cp1252", errors="replace")
    if "#BEGINCHANNELHEADER" not in text:
        from twin.importing.text import read as read_text

        return read_text(path)
    channels: dict[str, Channel] = {}
    for number, block in enumerate(text.split("#BEGINCHANNELHEADER")[1:], 1):
        lines = block.partition("#ENDCHANNELHEADER")[0].splitlines()
        codes = {code.strip(): value.strip() for code, _, value in (line.partition(",") for line in lines) if value}
        try:
            name = codes["200"] if codes["200"] not in channels else f"{codes['200']}.{number}"
            channels[name] = Channel(_values(path, codes), codes.get("202", ""))
        except (KeyError, ValueError) as error:
            raise InputError(path, f"channel {number}", f"expected a trace channel, code {error}") from error
    return [Table(path.stem, channels)]


def _values(path: Path, codes: dict[str, str]) -> np.ndarray:
    count, start, step = int(codes["220"]), float(codes.get("240", 0)), float(codes.get("241", 1))
    if codes["210"] == "IMPLIZIT":
        return start + step * np.arange(count)
    if codes["214"] != "REAL64":
        raise ValueError(f"214 is {codes['214']}, not REAL64")
    beside = path.with_name(PureWindowsPath(codes["211"]).name)
    if not beside.is_file():
        raise InputError(beside, "", f"no such file; {path.name} keeps its numbers there")
    data, first = np.fromfile(beside, "<f8"), int(codes["221"]) - 1
    values = data[first : first + count] if codes["213"] == "CHANNEL" else data.reshape(count, -1)[:, first]
    return start + step * values
