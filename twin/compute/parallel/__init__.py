"""Independent tasks on many processes: those of this computer, or a Dask cluster by naming its scheduler.

    twin compensate cone_frustum.nc cone_frustum.cls -o programs --tool-length 120 --workers 2
    twin volume --calibration mine.yaml --tool-length 120 --trials 1000000 --seed 1 --json volume.json

Several programs go into a folder, each under its own name, its report beside it (`.report.txt`, `.report.json`); `--json` and
`--report` take the account of all. A bad one stops none of the others and is named; the exit status is the worst (2 before 3
before 0). Each appears as soon as it is done, and stays on Ctrl-C.

`twin volume` draws whole machines from the calibration's covariance (correlations included) and runs each through the whole
chain at the same poses: U at the tool by draws beside U of first order, where it is largest, whether first order was enough
(JCGM 101, clause 8), and how the error over the volume (RMS and largest over the poses) is spread from machine to machine, as
they are and as this calibration leaves them. A million machines at 200 poses, 200 million poses, took 47 s on two shared cores
(4.3 million a second); memory does not grow with their number.

Work goes to processes of this computer (joblib; `--workers`, one a core if not given) or to a Dask cluster by its scheduler's
address (`pip install 'twin[cluster]'`, then there `dask scheduler` and `dask worker ADDRESS --nworkers N --nthreads 1`, here
`--scheduler ADDRESS`). `python -m tests.diagnosis.battery` and `tests.diagnosis.rivals` take the same two options. The same seed
gives the same bits on any number of workers, here or there: tasks have a fixed size and a seed each, linear algebra runs on one
thread, and results are added up in the order of the tasks. A worker that dies is replaced and its tasks run again; one task that
kills its workers four times over is named: of several programs the others are done all the same, else it ends the run (on a cluster:
`distributed.scheduler.allowed-failures`). Before the work every worker is asked for its versions of `twin` (digest of its
text), Python, numpy, scipy, casadi and pin: with others it is refused. Workers of another processor or compiler are used with a
warning: last digits may differ. To a cluster programs travel as data and come back as data; it needs no file system of ours.

**Trust.** A scheduler is trusted like your own code. Tasks and results travel as pickles (cloudpickle), and whoever reads a pickle runs
the code in it: the scheduler and its workers can run any code on this computer, and whoever reaches the scheduler's port can run any
code on its computer and on the workers. Name only schedulers of your own, in a network of your own, or with TLS: start scheduler and
workers with `--tls-ca-file`, `--tls-cert` and `--tls-key`, and give `--scheduler tls://host:8786 --tls-ca ca.pem --tls-cert me.pem
--tls-key me.key` here (`twin.Workers(scheduler=…, tls=twin.compute.parallel.Tls(…))`). Without these options Dask's own
configuration counts (`distributed.comm.tls.*`, `distributed.comm.require-encryption`). Only a certificate of that authority is then
accepted, on both sides.

From a script: `twin.draw_machines(kinematics, trials=…, workers=twin.Workers(8))`, `twin.compensate_files(…)`.
"""

from twin.compute.parallel.run import Workers, finished, in_order
from twin.compute.parallel.tls import Tls

__all__ = ["Tls", "Workers", "finished", "in_order"]
