"""Builds this package's messages with the real rosidl from the wheels of a virtual environment.

usage: interfaces_build.py PACKAGE_FOLDER VENV OUT_FOLDER

Prints what has to be set for Python to find the result, as JSON on the last line. Built again only
when one of the files changed.
"""

import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy

package, venv, out = (Path(argument) for argument in sys.argv[1:4])
build, install = out / "build", out / "install"

# The wheels' CMake files name the Python that they were built with.
for path in (venv / "share").rglob("*.cmake"):
    text = path.read_text(errors="ignore")
    ours = re.sub(r"/opt/python/[^;\"]*/numpy/_core/include", numpy.get_include(), text)
    ours = re.sub(r"/opt/python/[^;\"]*/include/python3\.\d+", sysconfig.get_paths()["include"], ours)
    if ours != text:
        path.write_text(ours)

site = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
environment = {
    "AMENT_PREFIX_PATH": f"{install}:{venv}",
    "LD_LIBRARY_PATH": f"{install}/lib:{venv}/lib",
    "PYTHONPATH": f"{install}/{site}:{venv}/{site}",
}
files = sorted([*package.glob("msg/*.msg"), *package.glob("srv/*.srv")])
files += [package / "package.xml", package / "CMakeLists.txt"]
digest = hashlib.sha256()
for path in files:
    digest.update(path.name.encode() + b"\0" + path.read_bytes())

out.mkdir(parents=True, exist_ok=True)
with open(out / "lock", "w") as lock:
    # Tests may run at once.
    fcntl.flock(lock, fcntl.LOCK_EX)
    marker = out / "built.txt"
    if not marker.exists() or marker.read_text() != digest.hexdigest():
        for folder in (build, install):
            shutil.rmtree(folder, ignore_errors=True)
        # A copy without the rest of the repository: messages only.
        source = out / "source"
        shutil.rmtree(source, ignore_errors=True)
        for name in ("msg", "srv", "launch_configs"):
            shutil.copytree(package / name, source / name)
        for name in ("package.xml", "CMakeLists.txt", "LICENSE"):
            shutil.copy(package / name, source)
        paths = {
            "PATH": f"{venv}/bin:{os.environ['PATH']}",
            "AMENT_PREFIX_PATH": str(venv),
            "LD_LIBRARY_PATH": f"{venv}/lib",
            "PYTHONPATH": f"{venv}/{site}",
        }
        run = lambda *command: subprocess.run(
            command, check=True, env={**os.environ, **paths}, stdout=sys.stderr
        )
        run(
            "cmake", "-G", "Ninja", "-S", str(source), "-B", str(build),
            f"-DCMAKE_PREFIX_PATH={venv}", f"-DCMAKE_INSTALL_PREFIX={install}",
            f"-DPython3_EXECUTABLE={sys.executable}",
            "-DVENEER_BUILD_NODE=OFF", "-DBUILD_TESTING=OFF",
        )
        run("cmake", "--build", str(build), "--target", "install")
        marker.write_text(digest.hexdigest())

print(json.dumps(environment))
