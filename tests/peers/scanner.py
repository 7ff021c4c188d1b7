"""A foreign scanner: serves frames of 625 x 750 pixels over OpenIGTLink, 30 a second, without those that are named.

Usage: scanner.py PORT FRAMES [WITHOUT...]
"""

import sys
import time

import numpy
import pyigtl

RATE_HZ = 30
port, frames, without = int(sys.argv[1]), int(sys.argv[2]), {int(number) for number in sys.argv[3:]}
server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
# Pixels of 0.1 by 0.2 mm; the image's second axis points down.
matrix = numpy.array([[0.1, 0, 0, -4], [0, -0.2, 0, 3], [0, 0, -1, 70], [0, 0, 0, 1]], dtype=numpy.float32)
while not server.is_connected():
    time.sleep(0.01)
for number in range(frames):
    if number in without:
        continue
    image = numpy.full((1, 750, 625), 40, dtype=numpy.uint8)
    image[0, 30, number % 625] = 200
    message = pyigtl.ImageMessage(
        image, ijk_to_world_matrix=matrix, world_coordinate_system="ras", timestamp=1000 + number / RATE_HZ, device_name="Probe"
    )
    server.send_message(message, wait=True)
    time.sleep(1 / RATE_HZ)
# The receiver ends by itself.
while server.is_connected():
    time.sleep(0.05)
