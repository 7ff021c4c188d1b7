"""A foreign client: connects to an OpenIGTLink server and prints every message that it receives as a line of JSON.

Usage: viewer.py PORT
"""

import json
import sys
import time

import pyigtl

FIELDS = {
    "TRANSFORM": lambda message: message.matrix.tolist(),
    "STRING": lambda message: message.string,
    "POINT": lambda message: [list(position) for position in message.positions],
}

client = pyigtl.OpenIGTLinkClient("127.0.0.1", int(sys.argv[1]))
while True:
    for message in client.get_latest_messages():
        content = FIELDS[message.message_type](message)
        line = {"type": message.message_type, "device": message.device_name, "stamp_s": message.timestamp, "content": content}
        print(json.dumps(line), flush=True)
    time.sleep(0.002)
