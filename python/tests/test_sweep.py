"""Sweeps give the table of `nsim sweep`, for every runner of their parts; NSIM names the program to compare with."""

import os
import subprocess
import sys
import tempfile
import unittest
from concurrent.futures import ThreadPoolExecutor

import nsim

NSIM = os.environ.get("NSIM", "nsim")
SWEEP = """Sweep(
    model: "vtsnn-slip",
    samples: "0..2",
    grid: [
        (paths: ["populations.touch.vth_mant"], values: [1300, 1500, 1900]),
        (paths: ["options.copies"], values: [1, 3]),
    ],
)
"""


class Sweeps(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.path = os.path.join(cls.folder.name, "sweep.ron")
        with open(cls.path, "w") as file:
            file.write(SWEEP)
        cls.theirs = subprocess.run([NSIM, "sweep", cls.path], capture_output=True, text=True, check=True).stdout

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_threads(self):
        for threads in [None, 1, 2]:
            self.assertEqual(nsim.sweep(self.path, threads=threads).csv, self.theirs)
        table = nsim.sweep(SWEEP)
        self.assertEqual((table.csv, len(table)), (self.theirs, 6))
        self.assertEqual(table.rows[1]["options.copies"], "3")

    def test_executors(self):
        with ThreadPoolExecutor(2) as client:
            self.assertEqual(nsim.sweep(self.path, client=client).csv, self.theirs)
            self.assertEqual(nsim.sweep(self.path, client=client, parts=4).csv, self.theirs)
        with self.assertRaises(TypeError):
            nsim.sweep(self.path, client=object())

    def test_dask(self):
        try:
            from dask.distributed import Client, LocalCluster
        except ImportError:
            print("absent: dask.distributed, sweeps on its clients were not tested", file=sys.stderr)
            self.skipTest("dask.distributed is absent")
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
            self.assertEqual(nsim.sweep(self.path, client=client).csv, self.theirs)

    def test_ray(self):
        try:
            import ray
        except ImportError:
            print("absent: ray, sweeps on it were not tested", file=sys.stderr)
            self.skipTest("ray is absent")
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
        try:
            self.assertEqual(nsim.sweep(self.path, client=ray, parts=3).csv, self.theirs)
        finally:
            ray.shutdown()

    def test_data_frames(self):
        try:
            import pandas
        except ImportError:
            print("absent: pandas, tables as data frames were not tested", file=sys.stderr)
            self.skipTest("pandas is absent")
        frame = nsim.sweep(self.path).table()
        self.assertIsInstance(frame, pandas.DataFrame)
        self.assertEqual(list(frame["populations.touch.vth_mant"]), [1300, 1300, 1500, 1500, 1900, 1900])

    def test_ctrl_c_ends_scenes_and_sweeps(self):
        long = "Sweep(model: \"vtsnn-slip\", samples: \"0..2\", grid: [(paths: [\"populations.out.vth_mant\"], from: 1, to: 3000, step: 1)])"
        script = f"""
import os, signal, threading, time, nsim
# A shell ignores it in its background.
signal.signal(signal.SIGINT, signal.default_int_handler)
mapping = nsim.load("vtsnn-slip").map()
for call in [lambda: mapping.run("scene:slip?samples=20000&seed=1"), lambda: nsim.sweep('{long}')]:
    threading.Timer(1, os.kill, (os.getpid(), signal.SIGINT)).start()
    begin = time.process_time()
    try:
        call()
    except KeyboardInterrupt:
        print("interrupted", time.process_time() - begin < 20)
"""
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=600)
        self.assertEqual((done.stdout, done.stderr), ("interrupted True\n" * 2, ""))

    def test_errors(self):
        with self.assertRaises(nsim.Error) as caught:
            nsim.sweep("Sweep(oops: 1)")
        self.assertEqual(caught.exception.code, "sweep.syntax")
        with self.assertRaises(nsim.Error):
            nsim.sweep('Sweep(model: "no-such-model", grid: [(paths: ["options.copies"], values: [1])])')


if __name__ == "__main__":
    unittest.main()
