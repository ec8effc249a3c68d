"""Compile functions with Numba, and keep the machine code wherever that is possible.

Numba keeps it beside the source, or else in the user's cache folder. By itself it raises where
it can write to neither, and a damaged file ends every later run.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

_DIGEST_BYTES = hashlib.sha256().digest_size


def compiled(**options: Any) -> Callable:
    """Decorator: a function as machine code that runs outside of the interpreter's lock.

    Parameters
    ----------
    **options
        Of `numba.njit`.
    """

    def compile_function(function):
        """The function as Numba's dispatcher."""
        dispatcher = njit(nogil=True, **options)(function)
        # Where no folder can be written to, it is compiled anew in every run.
        with contextlib.suppress(RuntimeError, OSError):
            dispatcher._cache = _Cache(function)
        return dispatcher

    return compile_function


class _Cache(FunctionCache):
    """Numba's cache of a function, of which what is damaged counts as missing."""

    def __init__(self, function: Callable):
        super().__init__(function)
        own = self._cache_file
        self._cache_file = _CheckedFile(
            own._cache_path, own._index_name.removesuffix(".nbi"), own._source_stamp
        )

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Machine code for a signature, None if there is none or it is damaged."""
        # A damaged pickle can fail in any way whatever.
        try:
            return super().load_overload(signature, target_context)
        except Exception:
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep machine code, if there is room."""
        with contextlib.suppress(OSError):
            super().save_overload(signature, data)


class _CheckedFile(IndexDataCacheFile):
    """Machine code behind its SHA-256: what is damaged must never be run."""

    def _load_data(self, name):
        with open(self._data_path(name), "rb") as file:
            digest, content = file.read(_DIGEST_BYTES), file.read()
        if hashlib.sha256(content).digest() != digest:
            raise OSError(f"{name} is damaged")
        return pickle.loads(content)

    def _save_data(self, name, data):
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(content).digest() + content)
