"""Finders of boards on pictures: drawn, photographed, empty, nasty; and what they cost.

All search on the thread that asks, ours and OpenCV's.
"""

import cv2

cv2.setNumThreads(1)
