"""Keeps OpenCV and FFmpeg from writing to standard error: our one line says what is wrong."""

import os

import cv2

_FFMPEG_QUIET = "-8"


def quieten_opencv() -> None:
    """Only for programs: it holds for the whole process."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", _FFMPEG_QUIET)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
