"""Measured recordings put to `twin diagnose`, and docs/proof-real.md, which tells the answers.

The list is YAML; paths are relative to it. Nothing of the recordings is kept, nor where they lie:

  - name: EMPS, a linear axis             # as the page calls it
    recordings: [emps/log.csv]
    options: [--robot, emps.yaml]         # of `twin diagnose`; a path that exists beside the list is found there
    known: friction is asymmetric         # what is known of the robot, if anything
    note: the maker's gains are used      # optional
"""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from tools.trials import ask
from tools.trials.store import commit, engine_hash, typeset
from twin.errors import InputError

KEYS = {"name": str, "recordings": list, "options": list, "known": str, "note": str}


def listed(path: Path) -> list[dict[str, Any]]:
    """The list of recordings.

    Raises:
        InputError: the file is missing, is not YAML, or is not such a list.
    """
    try:
        rows = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            path, "", f"expected a list of recordings ({error.strerror}); see tools/trials/real.py"
        ) from None
    except (YAMLError, UnicodeDecodeError) as error:
        raise InputError(
            path, "", f"not valid YAML: {getattr(error, 'problem', None) or 'not text in UTF-8'}"
        ) from None
    if not isinstance(rows, list) or not rows:
        raise InputError(path, "", "expected a list of items, each with `name` and `recordings`")
    for k, item in enumerate(rows):
        if not isinstance(item, dict) or not {"name", "recordings"} <= item.keys() or not item["recordings"]:
            raise InputError(path, f"[{k}]", "expected a `name` and a list of `recordings`")
        for key, value in item.items():
            if key not in KEYS:
                raise InputError(path, f"[{k}].{key}", f"expected one of {', '.join(KEYS)}")
            if not isinstance(value, KEYS[key]):
                what = "a list, as in [log.csv]" if KEYS[key] is list else "text"
                raise InputError(path, f"[{k}].{key}", f"expected {what}, found {value!r}")
    return rows


def asked(path: Path, limit_s: float) -> dict[str, Any]:
    """What the command says of every recording listed in `path`.

    Raises:
        InputError: of :func:`listed`.
    """
    here = path.resolve().parent

    def found(word: str) -> str:
        beside = here / word
        return str(beside) if not word.startswith("-") and beside.exists() else word

    rows = []
    for item in listed(path):
        with TemporaryDirectory() as scratch:
            words = [found(str(w)) for w in [*item["recordings"], *item.get("options", [])]]
            code, said, complaint = ask.run(["diagnose", *words, "--json", "--out", f"{scratch}/out"], limit_s)
        lines = [line for line in complaint.strip().splitlines() if line.strip()]
        rows.append({
            **{key: item.get(key, "") for key in ("name", "known", "note")},
            "diagnosis": _kept(json.loads(said)) if code == 0 else None,
            "complaint": "" if code == 0 else (lines[-1].replace(str(here), "") if lines else f"exit code {code}"),
        })  # fmt: skip
    return {"engine": engine_hash(), "commit": commit(), "rows": rows}


def _kept(diagnosis: dict[str, Any]) -> dict[str, Any]:
    return {key: diagnosis.get(key) for key in ("verdict", "effects", "probabilities", "error", "next_test", "triage")}


def page(content: dict[str, Any]) -> str:
    """The page on measured recordings, Markdown."""
    lines = ["# Proof: measured recordings", "",
             f"By engine {content['engine']} ({content['commit']}). Here nobody holds the truth; *known* is what is "
             "published of the robot. Error: RMS of the residual over RMS of the data.", ""]  # fmt: skip
    for row in content["rows"]:
        lines += [f"## {row['name']}", ""]
        if row["known"]:
            lines += [_sentence(f"Known: {row['known']}"), ""]
        d = row["diagnosis"]
        if d is None:
            lines += [f"No answer: {row['complaint']}", ""]
            continue
        lines += [f"Verdict: **{d['verdict']}**; nothing missing {_share(d['probabilities'].get('none'))}, something "
                  f"else {_share(d['probabilities'].get('other'))}.", ""]  # fmt: skip
        for e in d["effects"]:
            rivals = ", ".join(
                f"{a['effect']}@{a['site']} {_share(a['probability'])}"
                for a in e.get("alternatives", [])
                if _share(a["probability"]) != "0%"
            )
            values = "; ".join(f"{k} {_value(v)}" for k, v in (e.get("parameters") or {}).items())
            said = f"- {e['effect']}@{e['site']} {_share(e['probability'])}"
            said += f" ({values})" if values else ""
            said += f"; or {rivals}" if rivals else ""
            lines.append(said + (f". {e['evidence']}" if e.get("evidence") else ""))
        lines += [_sentence(f"- Triage: {note['text']}") for note in d.get("triage") or []]
        if d["effects"] or d.get("triage"):
            lines.append("")
        lines += [*_errors(d["error"] or {}), ""]
        if row["note"]:
            lines += [str(row["note"]), ""]
    return typeset("\n".join(lines))


def _sentence(text: str) -> str:
    return text.rstrip(".") + "."


def _share(p: Any) -> str:
    return f"{p:.0%}" if isinstance(p, int | float) else "–"


def _value(v: Any) -> str:
    """A list of numbers in one unit has it at its end; of several, each has its own."""
    value = v.get("value") if isinstance(v, dict) else v
    units = (v.get("unit", "") if isinstance(v, dict) else "").removesuffix("1").split(", ")
    texts = [f"{x:.3g}" for x in (value if isinstance(value, list) else [value])]
    if len(units) == 1:
        return f"{', '.join(texts)} {units[0]}".strip()
    return ", ".join(f"{text} {unit}" for text, unit in zip(texts, units, strict=True))


def _errors(error: dict[str, Any]) -> list[str]:
    """Rows as given, before, after; a recording of several is named by its kind's number."""
    head = ["| error | fitted | held out |", "|---|---|---|"]
    rows = []
    for key, label in (
        ("as_given", "model as it came"),
        ("before", "refitted, nothing added"),
        ("after", "with the answer"),
    ):
        item = error.get(key)
        if not isinstance(item, dict):
            continue
        cells = [_cell(item.get(side)) for side in ("train", "held_out")]
        rows.append(f"| {label} | {cells[0]} | {cells[1]} |")
    return [*head, *rows] if rows else []


def _cell(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(_cell(v) for v in value.values())
    return f"{value:.3g}" if isinstance(value, int | float) else "–"
