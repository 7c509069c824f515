"""OpenCV's FileStorage, with one clear line for whatever goes wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from palletloc.geometry import FloatArray
from palletloc.io.reading import InputError, read_text


class StorageFile:
    """A storage that is open for reading; its nodes live as long as it does.

    Parameters
    ----------
    path : Path
        XML, YAML or JSON as OpenCV writes it.

    Raises
    ------
    InputError
        If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        text = read_text(path)
        try:
            self._storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        except (cv2.error, SystemError) as error:
            raise InputError(f"{path}: is not a file of OpenCV: {_reason(error)}") from None
        if not self._storage.isOpened():
            raise InputError(f"{path}: is not a file of OpenCV; expected XML, YAML or JSON as FileStorage writes it")

    def has(self, key: str) -> bool:
        """Return whether there is such a key."""
        return not self._storage.getNode(key).empty()

    def node(self, key: str) -> cv2.FileNode:
        """Return the node of a key.

        Raises
        ------
        InputError
            If it is missing.
        """
        node = self._storage.getNode(key)
        if node.empty():
            raise InputError(f"{self._path}: {key}: is missing")
        return node

    def numbers(self, key: str) -> FloatArray | None:
        """Return the numbers of a key, be it a number, a list or a matrix, (n,); None where it is missing.

        Raises
        ------
        InputError
            If it holds anything else.
        """
        node = self._storage.getNode(key)
        if node.empty():
            return None
        try:
            if node.isInt() or node.isReal():
                values = np.array([node.real()])
            elif node.isSeq():
                values = np.array([node.at(i).real() for i in range(node.size())])
            else:
                values = np.asarray(node.mat(), dtype=np.float64).ravel()
        except (cv2.error, SystemError, TypeError, ValueError):
            values = np.array([np.nan])
        if not values.size or not np.isfinite(values).all():
            raise InputError(f"{self._path}: {key}: expected finite numbers")
        return values


def _reason(error: Exception) -> str:
    """Return the words of an error of OpenCV, on one line."""
    words = " ".join(str(error).split())
    return words.split("error: ", 1)[-1][:120]
