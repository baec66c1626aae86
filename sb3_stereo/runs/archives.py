"""Tensor files from anywhere: contents and sizes are checked before anything is allocated.

`torch.load(weights_only=True)` runs no code, but it makes what a file claims: it unpacks compressed members, calls
`bytearray(10**10)`, and takes one number for a tensor of a million. Here a file is refused before that.
"""

import os
import pickletools
import struct
import zipfile
import zlib
from typing import IO, Any

import torch as th

MIB = 2**20
MAX_REPEATED = 10_000  # values in lists that occur more than once
MAX_INDEX = MIB // 2  # of what a file of networks says about its tensors, about 250 bytes each

_GLOBALS = frozenset(
    {
        "collections OrderedDict",
        "torch Size",
        "torch device",
        "torch.storage UntypedStorage",
        "torch._utils _rebuild_tensor_v2",
        "torch._utils _rebuild_tensor_v3",
        "torch._utils _rebuild_parameter",
    }
)
# How a zip file ends: 22 bytes, and in a large one 76 before them. (PKWARE's APPNOTE.TXT, 4.3.14 to 4.3.16)
_LARGE_END = struct.Struct("<4s36xQQ4s4xQ4x22s")


def read_member(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    """Return a member of a zip file without ever holding more than `limit` bytes of it.

    Raises:
        ValueError: If there is none, it is larger, damaged or of a compression that SB3 does not write.
    """
    try:
        info = archive.getinfo(name)
    except KeyError as error:
        raise ValueError(f"it has no '{name}'") from error
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 1:
        raise ValueError(f"'{name}' is compressed in another way than SB3's files, or encrypted")
    if info.file_size > limit:
        raise ValueError(f"'{name}' is of {info.file_size} bytes, and these networks need at most {limit}")
    try:
        with archive.open(info) as file:
            return file.read(limit)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError) as error:
        raise ValueError(f"'{name}' is damaged ({error})") from error


def load_tensors(file: IO[bytes], max_index: int = MAX_INDEX) -> Any:
    """Return what `torch.save` wrote: numbers, texts, lists, maps and tensors, no larger in memory than in the file.

    Raises:
        ValueError: If it is anything else.
    """
    try:
        _check_archive(file, max_index)
        file.seek(0)
        content = th.load(file, map_location="cpu", weights_only=True)
        _check_values(content)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except Exception as error:  # what damaged archives and pickles make zipfile, pickletools and torch raise
        if type(error) is ValueError:
            raise
        reason = str(error).strip() or type(error).__name__
        raise ValueError(f"it is damaged ({reason.splitlines()[0]})") from error
    return content


def _check_archive(file: IO[bytes], max_index: int) -> None:
    """Raise a ValueError unless a file is one that `torch.save` writes today, with nothing in it that grows."""
    with open_zip(file, max_index) as archive:
        size, members = file.seek(0, os.SEEK_END), archive.infolist()
        if any(info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1 for info in members):
            raise ValueError("it is compressed inside, which PyTorch's files are not")
        if sum(info.file_size for info in members) > size:
            raise ValueError(f"it claims to hold more than its {size} bytes")
        pickles = [info for info in members if info.filename.casefold().endswith("data.pkl")]  # as torch finds it
        if len(pickles) != 1 or pickles[0].file_size > max_index:
            raise ValueError(f"it has not one 'data.pkl' of at most {max_index} bytes, as PyTorch's files have")
        _check_globals(archive.read(pickles[0]))


def open_zip(file: IO[bytes], max_index: int = MAX_INDEX) -> zipfile.ZipFile:
    """Open a zip file that ends with its directory, so that Python and torch must find the same one.

    Raises:
        ValueError: If it ends with anything else, or its directory has more than `max_index` bytes.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _LARGE_END.size))
    tail = file.read().rjust(_LARGE_END.size, b"\0")
    end, end_at = tail[-22:], size - 22
    length, offset = struct.unpack_from("<LL", end, 12)
    mark, large_length, large_offset, locator, large_end_at, _ = _LARGE_END.unpack(tail)
    if locator == b"PK\x06\x07":
        length, offset, end_at = large_length, large_offset, size - _LARGE_END.size
        if mark != b"PK\x06\x06" or large_end_at != end_at:
            raise ValueError("it is not a whole zip file")
    if end[:4] != b"PK\x05\x06" or end[-2:] != b"\0\0" or length + offset != end_at:
        raise ValueError("it is not a whole zip file")
    if length > max_index:
        raise ValueError(f"its directory has {length} bytes, and at most {max_index} are read")
    return zipfile.ZipFile(file)


def _check_globals(pickle: bytes) -> None:
    """Raise a ValueError if a pickle names more than torch's tensors and what they are made of."""
    for opcode, argument, _ in pickletools.genops(pickle):
        if opcode.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            raise ValueError(f"it holds more than tensors and plain values ({opcode.name})")
        if opcode.name == "GLOBAL" and not _is_plain(str(argument)):
            raise ValueError(f"it holds more than tensors and plain values ('{str(argument).replace(' ', '.')}')")


def _is_plain(name: str) -> bool:
    module, _, attribute = name.partition(" ")
    if module != "torch":
        return name in _GLOBALS
    is_storage = attribute.endswith("Storage") and attribute.isidentifier()
    return is_storage or name in _GLOBALS or isinstance(getattr(th, attribute, None), th.dtype)


def _check_values(content: Any) -> None:
    """Raise a ValueError if values would grow when they are copied: lists of lists of the same, expanded tensors."""
    known: dict[int, int] = {}
    lengths: list[int] = []
    if _count(content, known, lengths) > 2 * sum(lengths) + MAX_REPEATED:
        raise ValueError("the same lists or maps occur in it again and again")


def _count(value: Any, known: dict[int, int], lengths: list[int]) -> int:
    """How many values there are in one, those of a list that occurs again counted again."""
    if isinstance(value, th.Tensor):
        check_dense(value)
    if not isinstance(value, dict | list | tuple | set):
        return 1
    if id(value) not in known:
        known[id(value)] = 1  # it may hold itself
        items = value.values() if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_count(item, known, lengths) for item in items)
        lengths.append(1 + len(value))
    return known[id(value)]


def check_dense(tensor: th.Tensor) -> None:
    """Raise a ValueError if a tensor is larger than what is stored of it."""
    if tensor.layout != th.strided or tensor.device.type == "meta":
        raise ValueError("it has a tensor that is not dense")
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        raise ValueError(f"it has a tensor that claims the shape {tuple(tensor.shape)} and is smaller")
