"""The needle guide's protocol for Python, made of `protocol/spec/schema.json` and nothing else: no code is shared with the firmware.

Usage: guide_protocol.py SPEC_FOLDER vectors          checks every test vector
       guide_protocol.py SPEC_FOLDER port PORT        hello, questions, a hold and a move, refusals, an old frame
"""

import binascii
import json
import os
import pathlib
import select
import sys
import time
import tty


class Reader:
    """The payload of a frame, in postcard format: integers as varints, signed ones in zigzag, one byte for u8 and bool."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        if self.at + count > len(self.data):
            raise ValueError("too short")
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self):
        value = shift = 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


class Protocol:
    def __init__(self, folder):
        self.schema = json.loads((pathlib.Path(folder) / "schema.json").read_text())
        self.types = self.schema["types"]

    def decode(self, ty, reader):
        if isinstance(ty, str):
            if ty in ("u8", "bool"):
                byte = reader.take(1)[0]
                return bool(byte) if ty == "bool" else byte
            if ty in ("string", "bytes"):
                data = reader.take(reader.varint())
                return data.decode() if ty == "string" else list(data)
            value = reader.varint()
            return value if ty[0] == "u" else (value >> 1) ^ -(value & 1)
        if "option" in ty:
            return self.decode(ty["option"], reader) if reader.take(1)[0] else None
        if "tuple" in ty:
            return [self.decode(item, reader) for item in ty["tuple"]]
        described = self.types[ty["type"]]
        if "struct" in described:
            return {field["name"]: self.decode(field["type"], reader) for field in described["struct"]}
        number = reader.varint()
        if number >= len(described["enum"]):
            raise ValueError(f"no variant {number} of {ty['type']}")
        variant = described["enum"][number]
        content = variant["content"]
        if content is None:
            return variant["name"]
        if "newtype" in content:
            return {variant["name"]: self.decode(content["newtype"], reader)}
        return {variant["name"]: {field["name"]: self.decode(field["type"], reader) for field in content["struct"]}}

    def encode(self, ty, value):
        if isinstance(ty, str):
            if ty in ("u8", "bool"):
                return bytes([int(value)])
            if ty in ("string", "bytes"):
                data = value.encode() if ty == "string" else bytes(value)
                return varint(len(data)) + data
            return varint(value if ty[0] == "u" else value * 2 if value >= 0 else -value * 2 - 1)
        if "option" in ty:
            return b"\0" if value is None else b"\1" + self.encode(ty["option"], value)
        if "tuple" in ty:
            return b"".join(self.encode(item, one) for item, one in zip(ty["tuple"], value))
        described = self.types[ty["type"]]
        if "struct" in described:
            return b"".join(self.encode(field["type"], value[field["name"]]) for field in described["struct"])
        name, inner = (value, None) if isinstance(value, str) else next(iter(value.items()))
        variant = next(variant for variant in described["enum"] if variant["name"] == name)
        head, content = varint(variant["number"]), variant["content"]
        if content is None:
            return head
        if "newtype" in content:
            return head + self.encode(content["newtype"], inner)
        return head + b"".join(self.encode(field["type"], inner[field["name"]]) for field in content["struct"])

    def frame(self, way, message):
        payload = self.encode(self.schema[way], message)
        plain = payload + binascii.crc32(payload).to_bytes(4, "little")
        stuffed, block = bytearray(), bytearray()
        for byte in plain:
            if byte == 0:
                stuffed += bytes([len(block) + 1]) + block
                block = bytearray()
            else:
                block.append(byte)
        return b"\0" + bytes(stuffed) + bytes([len(block) + 1]) + bytes(block) + b"\0"

    def open(self, way, body):
        """The message between two delimiters; an error where it is damaged."""
        plain, at = bytearray(), 0
        while at < len(body):
            length = body[at]
            if length == 0 or at + length > len(body):
                raise ValueError("stuffing")
            plain += body[at + 1 : at + length]
            at += length
            if at < len(body):
                plain.append(0)
        payload, crc = bytes(plain[:-4]), bytes(plain[-4:])
        if len(plain) < 4 or binascii.crc32(payload).to_bytes(4, "little") != crc:
            raise ValueError("checksum")
        reader = Reader(payload)
        message = self.decode(self.schema[way], reader)
        if reader.at != len(payload):
            raise ValueError("bytes are left over")
        return message

    def program_crc(self, steps):
        return binascii.crc32(b"".join(self.encode({"type": "Step"}, step) for step in steps))


def check_vectors(folder):
    protocol = Protocol(folder)
    vectors = json.loads((pathlib.Path(folder) / "vectors.json").read_text())
    for way in ("to_device", "to_host"):
        for vector in vectors[way]:
            frame, message = bytes.fromhex(vector["frame_hex"]), vector["message"]
            found = protocol.open(way, frame[1:-1])
            assert found == message, f"{frame.hex()} is {found}, expected {message}"
            assert protocol.frame(way, message) == frame, f"{message} is {protocol.frame(way, message).hex()}"
    for vector in vectors["rejected"]:
        try:
            protocol.open("to_device", bytes.fromhex(vector["frame_hex"])[1:-1])
        except ValueError:
            continue
        raise AssertionError(f"not rejected: {vector['what']}")
    for vector in vectors["program_crc"]:
        assert protocol.program_crc(vector["steps"]) == vector["crc"], vector
    print(f"{len(vectors['to_device'])} commands, {len(vectors['to_host'])} messages")


class Client:
    def __init__(self, protocol, port):
        self.protocol, self.inbox, self.buffer = protocol, [], b""
        self.port = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.port)
        self.connection = self.id = 0
        messages = self.request("Hello")
        self.hello = next(message["Hello"] for message in messages if "Hello" in message)
        # The id goes on from the hello's: an answer to a hello that was sent twice may still be on its way.
        self.connection = next(message["Connected"]["connection"] for message in messages if "Connected" in message)
        assert self.hello["protocol_version"] == protocol.schema["version"]
        assert bytes(self.hello["schema_hash"]).hex() == protocol.schema["schema_hash"]

    def send(self, command):
        os.write(self.port, self.protocol.frame("to_device", command))

    def receive(self, seconds):
        """The next message; none where none comes in time."""
        deadline = time.monotonic() + seconds
        while True:
            while b"\0" in self.buffer:
                body, self.buffer = self.buffer.split(b"\0", 1)
                if body:
                    try:
                        return self.protocol.open("to_host", body)["message"]
                    except ValueError:
                        continue
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self.port], [], [], left)[0]:
                return None
            self.buffer += os.read(self.port, 4096)

    def request(self, request):
        """Sends a command until it is answered; what came with the answer."""
        command = {"id": self.id, "connection": self.connection, "request": request}
        self.id += 1
        return self.repeat(command)

    def repeat(self, command):
        messages = []
        for _ in range(20):
            self.send(command)
            while (message := self.receive(0.6)) is not None:
                messages.append(message)
                for kind in ("Ack", "Refused"):
                    if isinstance(message, dict) and message.get(kind, {}).get("id") == command["id"]:
                        return messages
        raise AssertionError(f"no answer to {command}")

    def refusal(self, request):
        answer = self.request(request)[-1]
        return answer["Refused"]["refusal"] if "Refused" in answer else None


def drive(folder, port):
    protocol = Protocol(folder)
    client = Client(protocol, port)
    description = next(m["Description"] for m in client.request("Describe") if "Description" in m)
    assert description["start_limit_us"] == protocol.schema["limits"]["start_ahead_us"]
    safety = next(m["Safety"] for m in client.request("Safety") if "Safety" in m)
    if safety["calibration"] == "Nominal":
        assert client.refusal("AcknowledgeCalibration") is None
    steps = [{"Move": {"x_um": 0, "y_um": 200, "speed_um_s": 1000}}, {"Hold": {"duration_ms": 50}}]
    for index, step in enumerate(steps):
        assert client.refusal({"LoadStep": {"index": index, "step": step}}) is None
    run = {"Run": {"steps": len(steps), "crc": protocol.program_crc(steps), "start_us": 0}}
    assert client.refusal({"Run": {**run["Run"], "start_us": 2**64 - 1}}) == "OutOfRange"
    assert client.refusal({"Run": {**run["Run"], "crc": 1}}) == "ProgramMismatch"
    assert client.refusal({"Retreat": {"x_um": 0, "y_um": -100}}) == "NotUnderLoad"
    accepted = {"id": client.id, "connection": client.connection, "request": run}
    assert client.refusal(run) is None
    ended = None
    began = time.monotonic()
    while ended is None and time.monotonic() < began + 60:
        message = client.receive(0.2)
        # The event may arrive before the answer to a question.
        for message in [message] if message else client.request("Status"):
            if "Event" in message and isinstance(message["Event"]["kind"], dict):
                ended = message["Event"]["kind"].get("ProgramEnded", {}).get("outcome", ended)
    assert ended == "Completed", ended
    for _ in range(description["answers_remembered"]):
        client.request("Status")
    answer = client.repeat(accepted)[-1]
    assert answer.get("Refused", {}).get("refusal") == "IdUsed", answer
    status = next(m["Status"] for m in client.request("Status") if "Status" in m)
    assert status["state"] == "Idle" and abs(status["position_counts"][1] - 200) < 60, status
    print("the guide moved, and an old frame did not move it again")


if __name__ == "__main__":
    if sys.argv[2] == "vectors":
        check_vectors(sys.argv[1])
    else:
        drive(sys.argv[1], sys.argv[3])
