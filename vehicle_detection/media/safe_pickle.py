"""Pickles as data: only a short list of classes is admitted, nothing else is even imported.

A pickle can name any function to call while it is read. This loader refuses every name but
those that a scaler, an SVM and NumPy's arrays are made of.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from typing import Any

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


class _Unpickler(pickle.Unpickler):
    """Admits a list of names."""

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
        return super().find_class(module, name)


def loads(content: bytes, trusted: Sequence = ()) -> Any:
    """What a pickle holds.

    Parameters
    ----------
    content : bytes
    trusted : sequence of str
        Further names to admit, "module.Class".

    Returns
    -------
    object

    Raises
    ------
    pickle.UnpicklingError
        It names what is not admitted. What is no pickle can fail in any other way.
    """
    return _Unpickler(content, trusted).load()
