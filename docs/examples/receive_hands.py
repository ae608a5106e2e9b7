"""Prints what `torchhand track 0 --out out --live --stream udp://127.0.0.1:9000` sends; only Python is needed."""

import json
import math
import socket
import sys

port = int(sys.argv[1]) if len(sys.argv) > 1 else 9000
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
    receiver.bind(("127.0.0.1", port))
    print(f"waiting for hands at udp://127.0.0.1:{port}", flush=True)
    while True:
        hand = json.loads(receiver.recv(65535))
        line = f"{hand['frame']} {hand['status']}"
        if hand["angles"] is not None:  # there is a hand in this frame
            angle = math.degrees(hand["angles"]["index_pip_fe"])
            spread = math.degrees(hand["angles_std"]["index_pip_fe"])
            x, y, z = hand["wrist"]["position"]
            line += f" index PIP {angle:.0f}° ± {spread:.0f}°, wrist at {x:.3f} {y:.3f} {z:.3f} m"
        print(line, flush=True)
