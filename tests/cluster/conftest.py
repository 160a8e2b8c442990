"""Engines for the tests of clusters: real processes on this machine, on loopback alone."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def spark() -> Iterator[Any]:
    """A session on a cluster of two workers, each a process with an executor of one core."""
    pytest.importorskip("pyspark", reason="PySpark is not installed (make test-cluster)")
    if shutil.which("java") is None:
        pytest.skip("there is no Java, which Spark runs on")
    from pyspark.sql import SparkSession

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SPARK_LOCAL_IP", "127.0.0.1")
        patch.setenv("SPARK_LOCAL_HOSTNAME", "localhost")
        patch.setenv("PYSPARK_PYTHON", sys.executable)
        builder = SparkSession.builder.master("local-cluster[2,1,1024]").appName("residua")  # pyright: ignore
        for name, value in {
            "spark.ui.enabled": "false",
            "spark.driver.host": "127.0.0.1",
            "spark.driver.bindAddress": "127.0.0.1",
            "spark.executor.memory": "512m",
            "spark.sql.shuffle.partitions": "2",
        }.items():
            builder = builder.config(name, value)
        session = builder.getOrCreate()
        yield session
        session.stop()


@pytest.fixture
def ends_worker(tmp_path: Path) -> Callable[[int], Callable[[], bool]]:
    """Return what makes a function, to be called by a worker, that ends a process once: its parent of a generation."""
    marker = str(tmp_path / "ended")

    def make(generation: int) -> Callable[[], bool]:
        def end() -> bool:
            try:
                os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                return False
            process = os.getpid()
            for _ in range(generation):
                with open(f"/proc/{process}/stat") as stat:
                    process = int(stat.read().rpartition(")")[2].split()[1])
            os.kill(process, signal.SIGKILL)
            return True

        return end

    return make


@pytest.fixture
def ended(tmp_path: Path) -> Callable[[], bool]:
    """Return what tells whether a worker was ended."""
    return (tmp_path / "ended").exists
