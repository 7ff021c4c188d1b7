"""Transverse frames of a bent needle, by PyMUST 0.1.9 (`pip install PyMUST`): writes pymust-clean.mha.

The near wall of a needle of 1.27 mm is an arc of scatterers, without others beside it; one plane wave of 64 elements of a linear array of
7.6 MHz, 50 dB in 8 bit. Frames are 2 mm apart.
"""

import zlib

import numpy as np
import pymust

PX_MM, SIZE, FRAMES, STEP_MM = 0.051, (190, 120), 20, 2.0
RADIUS_MM, DEPTH_MM = 0.635, 20.0
param = pymust.getparam("L11-5v")
param.Nelements = 64
param.fs = 4 * param.fc
param.TXapodization = np.hanning(param.Nelements + 2)[1:-1]
option = pymust.utils.Options()
option.WaitBar = False
option.ParPool = False
option.dBThresh = -40
delays = pymust.txdelay(param, 0.0)
W, H = SIZE
columns = (np.arange(W) - 0.5 * (W - 1)) * PX_MM * 1e-3
rows = (DEPTH_MM + (np.arange(H) - 0.5 * (H - 1)) * PX_MM) * 1e-3
X, Z = np.meshgrid(columns, rows)


def axis_mm(k):
    z = STEP_MM * k
    return -0.4 + 0.005 * z, DEPTH_MM + RADIUS_MM - 0.5 + 1.2 * np.exp(-z / 20) * np.cos(z / 20)


def envelope(k):
    x, y = axis_mm(k)
    angle = np.linspace(-0.6, 0.6, 41)
    place = np.c_[x + RADIUS_MM * np.sin(angle), y - RADIUS_MM * np.cos(angle)]
    strength = np.full(41, 0.4)
    # Silent ones in the corners: every frame then has as many samples.
    corners = np.array([[-7.0, DEPTH_MM + 5.0], [7.0, DEPTH_MM + 5.0]])
    place, strength = np.vstack([place, corners]), np.r_[strength, 0.0, 0.0]
    rf, _ = pymust.simus(place[:, 0] * 1e-3, place[:, 1] * 1e-3, strength, delays, param, option)
    iq = pymust.rf2iq(rf, param)
    if not MATRIX:
        MATRIX.append(pymust.dasmtx(1j * np.array(iq.shape), X, Z, delays, param))
    return np.abs(MATRIX[0] @ iq.ravel(order="F")).reshape(X.shape, order="F")


MATRIX = []


def write(path, frames):
    top = max(np.max(frame) for frame in frames)
    levels = [np.clip(255 * (1 + 20 * np.log10(frame / top + 1e-9) / 50), 0, 255).astype(np.uint8) for frame in frames]
    pixels = zlib.compress(b"".join(level.tobytes() for level in levels), 9)
    header = (
        f"ObjectType = Image\nNDims = 3\nComment = simulated with PyMUST\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
        f"CompressedData = True\nCompressedDataSize = {len(pixels)}\nDimSize = {W} {H} {len(frames)}\n"
        f"ElementSpacing = {PX_MM} {PX_MM} 1\nElementType = MET_UCHAR\nUltrasoundImageOrientation = MF\nElementDataFile = LOCAL\n"
    )
    with open(path, "wb") as file:
        file.write(header.encode() + pixels)


if __name__ == "__main__":
    write("pymust-clean.mha", [envelope(k) for k in range(FRAMES)])
