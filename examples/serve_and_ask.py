"""Solve over the network.

A server and a client in one script. Usually, `graspforce serve` runs the server.
"""

import sys
import time

from matplotlib.figure import Figure

import graspforce as gf

problem = gf.problems.load("ring/3-force").problem
seconds = []
with gf.service.Server(listen="tcp/127.0.0.1:0") as server, gf.service.Client(server.addresses[0]) as client:
    for _ in range(200):
        start = time.perf_counter()
        answer = client.solve(problem)
        seconds.append(time.perf_counter() - start)
    print(answer.status.value, answer.objective)
    print(client.status())

figure = Figure(figsize=(7, 3.2), layout="constrained")
axes = figure.subplots()
axes.hist([1e3 * s for s in sorted(seconds)[:-5]], bins=40, color="#0072B2")
axes.set(xlabel="round trip (ms)", ylabel="requests", title="Round trips of 200 requests on this machine")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "serve_and_ask.png", dpi=110)
