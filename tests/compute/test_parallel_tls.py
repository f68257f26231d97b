"""A Dask cluster with encrypted connections: it works with certificates, and without them gives an error of one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import dask
import pytest

from tests.compute import chores
from tests.compute.test_parallel import ROOT, until
from twin import cli
from twin._common.errors import InputError
from twin.compute.parallel import Tls, Workers, map_in_order

DASK = [sys.executable, "-m", "dask"]


def openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


def make_authority(folder: Path, name: str) -> Tls:
    """Create an authority and a certificate signed by it."""
    authority, subject = ["-subj", f"/CN=authority of {name}"], ["-subj", f"/CN={name}"]
    openssl(folder, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", *authority, "-keyout", f"{name}-ca.key", "-out",
            f"{name}-ca.pem", "-addext", "keyUsage=critical,keyCertSign,cRLSign")  # fmt: skip
    openssl(folder, "req", "-newkey", "rsa:2048", "-nodes", *subject, "-keyout", f"{name}.key", "-out", f"{name}.csr")
    # Python 3.13 rejects a certificate without these extensions (VERIFY_X509_STRICT).
    (folder / "extensions").write_text("subjectKeyIdentifier=hash\nauthorityKeyIdentifier=keyid\n")
    openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{name}-ca.pem", "-CAkey", f"{name}-ca.key", "-CAcreateserial",
            "-extfile", "extensions", "-days", "2", "-out", f"{name}.pem")  # fmt: skip
    return Tls(folder / f"{name}-ca.pem", folder / f"{name}.pem", folder / f"{name}.key")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Tls:
    return make_authority(tmp_path_factory.mktemp("certificates"), "shop")


@pytest.fixture(scope="module")
def strange(tmp_path_factory: pytest.TempPathFactory) -> Tls:
    return make_authority(tmp_path_factory.mktemp("strange"), "stranger")


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory, certificates: Tls) -> Iterator[str]:
    """Start a scheduler at tls:// and one worker."""
    room = tmp_path_factory.mktemp("cluster")
    written = room / "scheduler.json"
    files = [
        "--tls-ca-file",
        certificates.ca_file,
        "--tls-cert",
        certificates.certificate,
        "--tls-key",
        certificates.key,
    ]
    processes: list[subprocess.Popen[bytes]] = []

    def start(*words: str) -> None:
        command = [*DASK, *words, "--no-dashboard", *map(str, files)]
        quiet = subprocess.DEVNULL
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        processes.append(subprocess.Popen(command, stdout=quiet, stderr=quiet, cwd=room, env=environment))

    try:
        start("scheduler", "--host", "tls://127.0.0.1", "--port", "0", "--scheduler-file", str(written))
        until(lambda: written.exists() and written.stat().st_size > 0)  # made first, then written
        address = json.loads(written.read_text())["address"]
        start("worker", address, "--nthreads", "1", "--local-directory", str(room))
        yield address
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(30)


def test_work_on_an_encrypted_cluster(scheduler: str, certificates: Tls) -> None:
    assert scheduler.startswith("tls://")
    workers = Workers(scheduler=scheduler, tls=certificates)
    assert list(map_in_order(chores.squared, 1, range(5), workers)) == [1 + i * i for i in range(5)]


def test_dasks_own_configuration(scheduler: str, certificates: Tls) -> None:
    tls = "distributed.comm.tls."
    client = {f"{tls}client.cert": str(certificates.certificate), f"{tls}client.key": str(certificates.key)}
    with dask.config.set({f"{tls}ca-file": str(certificates.ca_file), **client}):
        assert list(map_in_order(chores.squared, 1, range(3), Workers(scheduler=scheduler))) == [1, 2, 5]


def test_certificates_of_another_authority(scheduler: str, strange: Tls) -> None:
    with pytest.raises(InputError, match=r"no Dask scheduler at this address.*one authority on both sides"):
        list(map_in_order(chores.squared, 1, range(3), Workers(scheduler=scheduler, tls=strange)))


def test_no_certificates(scheduler: str) -> None:
    with pytest.raises(InputError, match="TLS settings do not match") as caught:
        list(map_in_order(chores.squared, 1, range(3), Workers(scheduler=scheduler)))
    assert caught.value.value == scheduler


def test_encryption_that_is_required_and_not_there() -> None:
    required = {"distributed.comm.require-encryption": True}
    with dask.config.set(required), pytest.raises(InputError, match="TLS settings do not match"):
        list(map_in_order(chores.squared, 1, range(3), Workers(scheduler="tcp://127.0.0.1:1")))


def test_tls_files_for_a_scheduler_without_tls(certificates: Tls) -> None:
    for scheduler in (None, "tcp://127.0.0.1:8786", "127.0.0.1:8786"):
        with pytest.raises(InputError, match="does not use TLS"):
            Workers(scheduler=scheduler, tls=certificates)


@pytest.mark.parametrize("broken", ["missing", "text", "no key"])
def test_files_that_are_no_certificates(tmp_path: Path, certificates: Tls, broken: str) -> None:
    path = tmp_path / "file.pem"
    if broken == "text":
        path.write_text("not a certificate")
    tls = Tls(certificates.ca_file, certificates.certificate) if broken == "no key" else Tls(path, path, path)
    with pytest.raises(InputError) as caught:
        list(map_in_order(chores.squared, 1, range(3), Workers(scheduler="tls://127.0.0.1:1", tls=tls)))
    assert caught.value.file == str(certificates.certificate if broken == "no key" else path)


def test_the_options_of_a_command(
    tmp_path: Path, scheduler: str, certificates: Tls, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in "ab":
        (tmp_path / f"{name}.nc").write_text("G21 G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X120 F500\nM30\n")
    words = [
        "compensate",
        str(tmp_path / "a.nc"),
        str(tmp_path / "b.nc"),
        "-o",
        str(tmp_path / "out"),
        "--scheduler",
        scheduler,
    ]
    run = command(capsys)
    files = ["--tls-ca", str(certificates.ca_file), "--tls-cert", str(certificates.certificate)]
    assert run(*words, *files[:2]) == (2, "twin: incomplete TLS files; expected --tls-ca and --tls-cert, and --tls-key "
                                          "if the certificate file holds no key\n")  # fmt: skip
    status, output = run(*words, *files, "--tls-key", str(certificates.key))
    assert status == 0 and output == ""
    assert {path.name for path in (tmp_path / "out").glob("*.nc")} == {"a.nc", "b.nc"}


def command(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Return a function that runs the command line and returns exit status and stderr."""

    def run(*words: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(list(words))
        return int(ended.value.code or 0), capsys.readouterr().err

    return run


def test_the_documentation_says_whom_a_scheduler_must_trust(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["doc", "many"])
    page = " ".join(capsys.readouterr().out.split())
    assert "only as you trust your own code" in page and "cloudpickle" in page and "--tls-ca" in page
