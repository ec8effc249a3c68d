"""Pickles as data: only a short list of classes is admitted, nothing else is even imported.

A pickle can name any function to call while it is read. This loader refuses every name but
those that a scaler, an SVM and NumPy's arrays are made of.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

_MARK = b"sha256:"
_DIGEST = hashlib.sha256().digest_size
_TAIL = len(_MARK) + _DIGEST
_NUMPY = {
    (f"numpy.{core}.{module}", name)
    for core in ("core", "_core")
    for module, name in (
        ("multiarray", "_reconstruct"),
        ("multiarray", "scalar"),
        ("numeric", "_frombuffer"),
    )
} | {("numpy", "ndarray"), ("numpy", "dtype")}
_SKLEARN = {
    ("sklearn.svm._classes", "LinearSVC"),
    ("sklearn.svm._classes", "SVC"),
    ("sklearn.preprocessing._data", "StandardScaler"),
}


def _plain_dtype(kind: str, *rest: Any) -> np.dtype:
    """A type of plain numbers: an array of objects would follow any address in the file."""
    dtype = np.dtype(kind)
    if dtype.kind not in "fiub":
        raise pickle.UnpicklingError(f"arrays of {dtype} are not admitted")
    return dtype


# The stubs of the standard library do not know the unpickler that is written in Python.
_PythonUnpickler: Any = pickle._Unpickler  # type: ignore[attr-defined]


class _Unpickler(_PythonUnpickler):
    """Admits a list of names. In Python throughout, so that each step can be looked at."""

    dispatch = dict(_PythonUnpickler.dispatch)

    def __init__(self, content: bytes, trusted: Sequence):
        super().__init__(io.BytesIO(content))
        self._admitted = _NUMPY | _SKLEARN | {tuple(t.rpartition(".")[::2]) for t in trusted}

    def find_class(self, module: str, name: str) -> Any:
        """A class or function that the pickle names, if it is admitted."""
        if (module, name) not in self._admitted:
            raise pickle.UnpicklingError(
                f"it names {module}.{name}, which is not admitted; "
                f"if you trust the file, admit it with --trust {module}.{name}"
            )
        if (module, name) == ("numpy", "dtype"):
            return _plain_dtype
        return super().find_class(module, name)

    def load_build(self) -> None:
        """Give an object its state; a type of numbers has none but its byte order."""
        state, dtype = self.stack[-1], self.stack[-2]
        if isinstance(dtype, np.dtype):
            plain = isinstance(state, tuple) and len(state) == 8 and state[2:5] == (None,) * 3
            if not plain or state[1] not in ("<", ">", "|", "="):
                raise pickle.UnpicklingError("a type of numbers with fields is not admitted")
            self.stack.pop()
            self.stack[-1] = dtype.newbyteorder(state[1]) if state[1] in "<>" else dtype
            return
        super().load_build()

    dispatch[pickle.BUILD[0]] = load_build


def dumps(value: Any) -> bytes:
    """A pickle of a value, and behind it its SHA-256, which other readers of pickles skip."""
    content = pickle.dumps(value)
    return content + _MARK + hashlib.sha256(content).digest()


def loads(content: bytes, trusted: Sequence = ()) -> Any:
    """What `dumps` has packed.

    Parameters
    ----------
    content : bytes
    trusted : sequence of str
        Further names to admit, "module.Class".

    Returns
    -------
    object

    Warns
    -----
    UserWarning
        There is no checksum: it was packed by other means.

    Raises
    ------
    pickle.UnpicklingError
        It is damaged, or names what is not admitted. What is no pickle can fail in any other way.
    """
    packed, mark, digest = content[:-_TAIL], content[-_TAIL:-_DIGEST], content[-_DIGEST:]
    if mark != _MARK:
        warnings.warn("a parameter file without a checksum: damage goes unnoticed", stacklevel=3)
    elif hashlib.sha256(packed).digest() != digest:
        raise pickle.UnpicklingError("it is damaged: its checksum does not agree")
    return _Unpickler(content, trusted).load()


def require_plain(value: Any) -> None:
    """Refuse an object of which a stored value hides a method of its class.

    Raises
    ------
    ValueError
        It has such a value.
    """
    for name in vars(value):
        if callable(getattr(type(value), name, None)):
            raise ValueError(f"a value in place of the method {name}")
