"""Bend logs (CSV) and flight logs (MCAP)."""

from __future__ import annotations

import csv
import importlib
import io
import json
import math
import os
import warnings
import zlib
from array import array
from gzip import GzipFile
from itertools import islice
from typing import Any, BinaryIO, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, Union, cast

from ._errors import LogError

Columns = Dict[str, Sequence[Any]]

_REQUIRED = ("time_s", "piston1_mm", "piston2_mm", "piston3_mm")
_GROUPS = ("acc_x_m_s2 acc_y_m_s2 acc_z_m_s2", "gyr_x_rad_s gyr_y_rad_s gyr_z_rad_s", "mag_x_ut mag_y_ut mag_z_ut")
_NUMERIC = {
    *_REQUIRED, *"cmd_bend_deg cmd_dir_deg cmd_len_mm temp_c ref_qw ref_qx ref_qy ref_qz".split(),
    *"pressure1_kpa pressure2_kpa pressure3_kpa".split(),
    *(prefix + name for prefix in ("", "base_") for group in _GROUPS for name in group.split()),
}
# rows that are converted at a time
_CHUNK = 4096
_MCAP_MAGIC = b"\x89MCAP0\r\n"
# the exact input of the loop, which only the program reads
_EXACT = "/cycles"


def read_log(path: Union[str, "os.PathLike[str]"], *, engine: Optional[str] = None) -> Any:
    """Reads a bend log, *.csv or *.csv.gz, or a flight log, *.mcap.

    Without an `engine` a table is a dict of columns, each an `array` of floats; with "pandas" or "polars" it is a DataFrame.
    Columns and their units are listed in docs/formats.md. An empty field is a missing value: NaN, in polars null. A column that
    is not listed there is kept, as text (missing: None) if it does not hold numbers.

    A flight log, which needs the package `mcap`, is read as a dict of tables by topic, each with `time_s`, s since 1970; a
    nested value has the name of its place, as in `target.bend_deg`, with a number from 1 on for an element of a list. Topics
    that are not JSON, as the exact input of the loop, are left out.

    Raises `LogError`, which names file, line and column, if the file is no log, is cut short, lacks a required column, or has
    gaps or steps back in time. Units and wiring are not judged; `diagnose` does that.
    """
    file = os.fspath(path)
    make_table = _engine(engine)
    try:
        with open(file, "rb") as raw:
            magic = raw.read(len(_MCAP_MAGIC))
            raw.seek(0)
            if magic == _MCAP_MAGIC:
                return {topic: make_table(table) for topic, table in _flight_log(file, raw).items()}
            unpacked = cast(BinaryIO, GzipFile(fileobj=raw)) if magic.startswith(b"\x1f\x8b") else raw
            return make_table(_bend_log(file, unpacked))
    except OSError as problem:
        raise LogError(f"{file}: {problem.strerror or problem}") from problem


def _engine(name: Optional[str]) -> Callable[[Columns], Any]:
    if name is None:
        return lambda columns: columns
    if name not in ("pandas", "polars"):
        raise ValueError(f"engine is {name!r}; it must be 'pandas', 'polars' or None")
    module = _package(name)
    if name == "polars":
        return lambda columns: module.DataFrame({name: list(column) for name, column in columns.items()}).fill_nan(None)
    return cast(Callable[[Columns], Any], module.DataFrame)


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as problem:
        raise ImportError(f"this needs the package `{name}`: `pip install {name}`") from problem


def _bend_log(file: str, raw: BinaryIO) -> Columns:
    _check_encoding(file, raw)
    reader = csv.reader(io.TextIOWrapper(raw, encoding="utf-8-sig", newline=""), skipinitialspace=True)
    rows = _rows(file, reader)
    try:
        header = [name.strip() for name in next(rows)[1]]
    except StopIteration:
        raise LogError(f"{file}: is empty") from None
    _check_header(file, header)
    columns: List[Any] = [array("d") if name in _NUMERIC else [] for name in header]
    before = -math.inf
    while True:
        chunk = list(islice(rows, _CHUNK))
        if not chunk:
            break
        for line, row in chunk:
            if len(row) != len(header):
                column = header[min(len(row), len(header) - 1)]
                raise LogError(
                    f"{file}, line {line}, column {column}: the line has {len(row)} fields where the header has {len(header)}; "
                    "it is cut short or has stray commas"
                )
        for k, name in enumerate(header):
            fields = [row[k] for _, row in chunk]
            if name not in _NUMERIC:
                columns[k] += fields
                continue
            values = _numbers(fields)
            if values is None or (name in _REQUIRED and any(map(math.isnan, values))):
                raise _bad_field(file, name, [(line, row[k]) for line, row in chunk])
            if name == _REQUIRED[0]:
                for (line, _), now in zip(chunk, values):
                    if now <= before:
                        why = f"{now:g} s does not come after {before:g} s; time must strictly increase"
                        raise LogError(f"{file}, line {line}, column {name}: {why}")
                    before = now
            columns[k].extend(values)
    if not columns[0]:
        raise LogError(f"{file}: has no rows below its header line")
    return {name: _kept(column) for name, column in zip(header, columns)}


def _check_encoding(file: str, raw: BinaryIO) -> None:
    try:
        start = raw.read(64)
    except (OSError, EOFError, zlib.error) as problem:
        raise LogError(f"{file}, line 1: cannot be read: {problem}; the file is cut short or damaged") from problem
    raw.seek(0)
    if start.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in start:
        raise LogError(f"{file}, line 1: this is UTF-16 text, as some Windows programs write it, or no text; save it as UTF-8")


def _rows(file: str, reader: Iterator[List[str]]) -> Iterator[Tuple[int, List[str]]]:
    """The rows with the numbers of their lines."""
    lines: Any = reader
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except UnicodeDecodeError as problem:
            raise LogError(f"{file}, line {lines.line_num + 1}: this is not UTF-8 text; save it as UTF-8") from problem
        except (OSError, EOFError, zlib.error, csv.Error) as problem:
            why = f"cannot be read: {problem}; the file is cut short or damaged, copy it again"
            raise LogError(f"{file}, line {lines.line_num + 1}: {why}") from problem
        if row:
            yield lines.line_num, row


def _check_header(file: str, header: List[str]) -> None:
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            raise LogError(f"{file}, line 1: the columns are separated by {name}; separate them by commas")
    for name in _REQUIRED:
        if name not in header:
            raise LogError(f"{file}, line 1, column {name}: is missing; the header names {', '.join(header)}")
    for name in header:
        if header.count(name) > 1:
            raise LogError(f"{file}, line 1, column {name}: is there twice")


def _numbers(fields: Sequence[str]) -> Optional[List[float]]:
    """The fields as finite numbers, NaN where one is empty or says so; None if one is neither."""
    try:
        values = [float(field) if field.strip() else math.nan for field in fields]
    except ValueError:
        return None
    # Python alone reads an underscore within a number
    return None if "_" in "".join(fields) or any(map(math.isinf, values)) else values


def _bad_field(file: str, name: str, fields: Sequence[Tuple[int, str]]) -> LogError:
    """The error of the first field that is no number, or else of the first that is missing."""
    for line, field in fields:
        if _numbers([field]) is None:
            return LogError(f"{file}, line {line}, column {name}: `{field.strip()[:100]}` is not a finite number")
    line, field = next((line, field) for line, field in fields if not field.strip() or math.isnan(float(field)))
    return LogError(f"{file}, line {line}, column {name}: `{field}` is not a number; this column must not have gaps")


def _kept(column: Any) -> Sequence[Any]:
    """A column that is not of the contract, as numbers if it holds such."""
    if isinstance(column, array):
        return column
    values = _numbers(column)
    return array("d", values) if values is not None else [field or None for field in column]


def _flight_log(file: str, raw: BinaryIO) -> Dict[str, Columns]:
    stream = _package("mcap.stream_reader")
    end_of_file = _package("mcap.exceptions").EndOfFile
    protobuf = _package("mcap_protobuf.decoder").DecoderFactory()
    as_dict = _package("google.protobuf.json_format").MessageToDict
    channels: Dict[int, Any] = {}
    schemas: Dict[int, Any] = {}
    rows: Dict[str, List[Dict[str, Any]]] = {}
    try:
        for record in stream.StreamReader(raw, validate_crcs=True).records:
            if type(record).__name__ == "Schema":
                schemas[record.id] = record
            elif type(record).__name__ == "Channel":
                channels[record.id] = record
            elif type(record).__name__ == "Message":
                channel = channels[record.channel_id]
                decode = protobuf.decoder_for(channel.message_encoding, schemas.get(channel.schema_id))
                if channel.topic == _EXACT:
                    continue
                if decode:
                    said = as_dict(decode(record.data), preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
                elif channel.message_encoding == "json":  # a log of an earlier version
                    said = json.loads(record.data)
                else:
                    continue
                rows.setdefault(channel.topic, []).append({"time_s": record.log_time / 1e9, **_flat(said)})
    except end_of_file:
        warnings.warn(f"{file} was not closed; it is read up to its last whole chunk", stacklevel=3)
    except Exception as problem:  # a reader of damaged bytes fails in any way
        raise LogError(f"{file}: is damaged ({type(problem).__name__}: {problem}); `retroflex log cut` takes out what is whole") from problem
    return {topic: _columns(of) for topic, of in rows.items()}


def _flat(value: Any, name: str = "") -> Dict[str, Any]:
    """The numbers and texts within a value by the names of their places."""
    if isinstance(value, Mapping):
        parts: Any = value.items()
    elif isinstance(value, list):
        parts = enumerate(value, 1)
    else:
        return {name: value}
    prefix = f"{name}." if name else ""
    return {place: leaf for key, part in parts for place, leaf in _flat(part, f"{prefix}{key}").items()}


def _columns(rows: Sequence[Dict[str, Any]]) -> Columns:
    columns: Columns = {}
    names = dict.fromkeys(name for row in rows for name in row)
    for name in names:
        if any(other.startswith(f"{name}.") for other in names):
            # null in some rows, nested in others
            continue
        values = [row.get(name) for row in rows]
        if all(value is None or type(value) in (int, float) for value in values):
            columns[name] = array("d", [math.nan if value is None else cast(float, value) for value in values])
        else:
            columns[name] = values
    return columns
