"""LinuxCNC's own kinematics modules in this process: their compiled C formulas, with pins that are plain memory."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

MODULES = Path("/usr/lib/linuxcnc/modules")
needs_modules = pytest.mark.skipif(
    not (MODULES / "maxkins.so").exists() or shutil.which("gcc") is None,
    reason="needs LinuxCNC and a compiler: apt-get install linuxcnc-uspace gcc",
)
STUBS = """
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
static struct { char name[64]; double *value; } pins[64];
static int count = 0;
int hal_init(const char *name) { count = 0; return 1; }
int hal_ready(int id) { return 0; }
int hal_exit(int id) { return 0; }
void *hal_malloc(long size) { return calloc(1, size); }
static double *made(const char *name) {
    double *value = calloc(1, sizeof(double));
    strncpy(pins[count].name, name, 63);
    pins[count++].value = value;
    return value;
}
int hal_pin_float_new(const char *name, int dir, double **pin, int id) { *pin = made(name); return 0; }
int hal_pin_float_newf(int dir, double **pin, int id, const char *form, ...) {
    char name[64]; va_list rest; va_start(rest, form); vsnprintf(name, 64, form, rest); va_end(rest);
    *pin = made(name); return 0;
}
int hal_pin_bit_new(const char *name, int dir, void **pin, int id) { *pin = calloc(1, 8); return 0; }
int hal_pin_s32_new(const char *name, int dir, void **pin, int id) { *pin = calloc(1, 8); return 0; }
int rtapi_print(const char *form, ...) { return 0; }
int rtapi_print_msg(int level, const char *form, ...) { return 0; }
int twin_set(const char *name, double value) {
    for (int i = 0; i < count; i++) if (!strcmp(pins[i].name, name)) { *pins[i].value = value; return 0; }
    return -1;
}
"""


@cache
def _stubs() -> ctypes.CDLL:
    with TemporaryDirectory() as folder:
        source, library = Path(folder) / "stubs.c", Path(folder) / "stubs.so"
        source.write_text(STUBS)
        subprocess.run(["gcc", "-shared", "-fPIC", "-w", "-o", library, source], check=True)
        return ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


def forward(module: str, pins: Mapping[str, float], joints: np.ndarray) -> np.ndarray:
    """Return the positions (n, 9) X Y Z A B C U V W of the tool that a module finds for joints (n, joints), mm and degrees."""
    stubs = _stubs()
    kins = ctypes.CDLL(str(MODULES / f"{module}.so"))
    assert kins.rtapi_app_main() == 0
    for name, value in pins.items():
        assert stubs.twin_set(f"{module}.{name}".encode(), ctypes.c_double(value)) == 0, name
    found = []
    for row in joints:
        given, pose, flags = (ctypes.c_double * 16)(*row), (ctypes.c_double * 9)(), ctypes.c_ulong(0)
        assert kins.kinematicsForward(given, pose, ctypes.byref(flags), ctypes.byref(flags)) == 0
        found.append(list(pose))
    return np.array(found)
