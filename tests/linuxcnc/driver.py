#!/usr/bin/python3
"""Display of LinuxCNC in the tests: does what ``actions.json`` says and writes ``results.json``. It runs in the system's own Python."""

import json
import subprocess
import sys
import time
import traceback

import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def hal(words):
    done = subprocess.run(["halcmd", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"halcmd {' '.join(words)}: {done.stderr}")
    return done.stdout.strip()


def said():
    """Return the control's error messages since the last call."""
    texts = []
    while (message := errors.poll()) is not None:
        texts.append(message[1])
    return texts


def mode(which):
    command.mode(which)
    command.wait_complete(10)


def home():
    for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
        command.state(state)
        command.wait_complete(10)
    mode(linuxcnc.MODE_MANUAL)
    status.poll()
    joints = status.joints
    command.home(-1)
    for _ in range(1000):
        status.poll()
        if all(status.homed[:joints]):
            break
        time.sleep(0.01)
    else:
        raise RuntimeError("not homed")
    command.teleop_enable(1)
    command.wait_complete(10)


def idle(seconds):
    end = time.time() + seconds
    time.sleep(0.05)
    while time.time() < end:
        status.poll()
        if status.interp_state == linuxcnc.INTERP_IDLE and status.inpos and not status.queue:
            return
        time.sleep(0.005)
    raise RuntimeError("not finished in time")


def mdi(text, seconds=60):
    mode(linuxcnc.MODE_MDI)
    command.mdi(text)
    command.wait_complete(seconds)
    idle(seconds)


def program(path, seconds=300):
    mode(linuxcnc.MODE_AUTO)
    command.program_open(path)
    command.wait_complete(10)
    command.auto(linuxcnc.AUTO_RUN, 0)
    idle(seconds)


recorder = []


def record(path):
    recorder.append(subprocess.Popen(["halsampler", "-c", "0"], stdout=open(path, "w")))
    time.sleep(0.1)
    hal(["setp", "sampler.0.enable", "1"])


def stop():
    hal(["setp", "sampler.0.enable", "0"])
    time.sleep(0.3)
    recorder.pop().terminate()


def position():
    time.sleep(0.1)
    status.poll()
    return {"joints": status.joint_position[: status.joints], "axes": status.position[:9]}


ACTIONS = {
    "home": home,
    "mdi": mdi,
    "program": program,
    "hal": hal,
    "sleep": time.sleep,
    "record": record,
    "stop": stop,
    "position": position,
}
results = {"done": [], "said": [], "failed": None}
try:
    for name, *arguments in json.load(open("actions.json")):
        results["done"].append([name, ACTIONS[name](*arguments)])
        results["said"] += said()
except Exception:
    results["failed"] = traceback.format_exc()
    results["said"] += said()
for process in recorder:
    process.terminate()
json.dump(results, open("results.json", "w"))
sys.exit(0)
