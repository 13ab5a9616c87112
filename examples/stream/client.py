#!/usr/bin/env python
"""What does the sensor feel? Prints contacts and their sum: ``python client.py [host] [port]``."""

import json
import socket
import sys

host = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
port = int(sys.argv[2]) if len(sys.argv) > 2 else 5757

with socket.create_connection((host, port)) as link, link.makefile("rb") as lines:
    for line in lines:
        message = json.loads(line)
        if message["type"] == "hello":
            print(message["design"], message["markers"], "markers, protocol", message["version"])
        elif message["type"] == "end":
            print("end:", message["reason"])
        elif message["type"] != "frame":
            continue  # of a later version
        elif not message["valid"]:
            print(message["sequence"], "not valid:", *message["warnings"])
        else:
            for contact in message["contacts"]:
                print(message["sequence"], contact["force_N"], "N at", contact["position_mm"])
            if message["contacts"]:
                force, moment = message["net_force_N"], message["net_moment_Nmm"]
                about = message["moment_about_mm"]
                print("  net force", force, "N, moment", moment, "N mm about", about, "mm")
