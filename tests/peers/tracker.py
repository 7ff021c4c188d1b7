"""A foreign tracker: serves the needle's shape, as a command prints it, over OpenIGTLink.

Each shape is kept as a file before it is sent, and sent with the number of that file as its points' name.

Usage: tracker.py PORT FOLDER COMMAND...
"""

import csv
import pathlib
import subprocess
import sys
import time

import pyigtl

port, folder, command = int(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3:]
server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
number = 0
while True:
    if not server.is_connected():
        time.sleep(0.01)
        continue
    measured_s = time.time()
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        time.sleep(0.05)
        continue
    (folder / f"{number}.csv").write_text(result.stdout)
    rows = list(csv.DictReader(result.stdout.splitlines()))
    # A point is x, y, z.
    points = [[float(row.get("deflection_x_mm") or 0), float(row["deflection_y_mm"]), float(row["z_mm"])] for row in rows]
    server.send_message(pyigtl.PointMessage(points, timestamp=measured_s, device_name="NeedleShape"), wait=True)
    number += 1
    time.sleep(0.1)
