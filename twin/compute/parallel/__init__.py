"""Independent tasks on many processes: on this computer, or on a Dask cluster given by the address of its scheduler.

    twin compensate cone_frustum.nc cone_frustum.cls -o programs --tool-length 120 --workers 2
    twin volume --calibration mine.yaml --tool-length 120 --trials 1000000 --seed 1 --json volume.json

Several programs are written to a folder, each under its own name and with its report (`.report.txt`, `.report.json`); `--json` and
`--report` give the summary of all. An error in one program is reported and does not stop the others; the exit status is the worst (2
before 3 before 0). Each program is written as soon as it is done, and is kept on Ctrl-C.

`twin volume` draws machines from the covariance of the calibration (correlations included) and evaluates each at the same poses. It
reports the expanded uncertainty U at the tool by Monte Carlo and by first-order propagation, where U is largest, whether first order
is adequate (JCGM 101, clause 8), and the distribution over the machines of the error in the volume (RMS and maximum over the poses),
uncompensated and compensated with this calibration. A million machines at 200 poses, 200 million poses, took 16 to 18 s on two shared
cores (11 to 12 million a second); memory does not grow with their number.

200 programs of 5,000 to 20,000 blocks took 9 to 11 s in one process, which uses a second core for a sixth of its work, 6 to 6.5 s in
two, and 8 to 9 s on two Dask workers with scheduler and client on the same two cores.

Work goes to processes of this computer (`--workers`, by default one per core; on Linux copies of the running one, which start at once)
or to a Dask cluster by the address of its scheduler (`pip install 'twin[cluster]'`, then there `dask scheduler` and `dask worker
ADDRESS --nworkers N --nthreads 1`, here `--scheduler ADDRESS`). `python -m tests.diagnosis.battery` and `tests.diagnosis.rivals` take
the same two options. The same seed gives the same bits on any number of workers, local or remote: tasks have a fixed size and a seed
each, linear algebra runs on one thread, and results are added in the order of the tasks. A worker that dies is replaced and its tasks
are repeated. A task whose worker dies four times is reported as failed: with several programs the others are completed, otherwise the
run ends (on a cluster: `distributed.scheduler.allowed-failures`). Before the work the versions of `twin` (digest of its source),
Python, numpy, scipy, casadi and pin on every worker are checked; a worker with other versions is rejected. Workers with another
processor or compiler are used with a warning: last digits may differ. Programs are sent to a cluster and back as data; it needs no
shared file system.

**Trust.** Trust a scheduler only as you trust your own code. Tasks and results are sent as pickles (cloudpickle), and unpickling runs
the code in them: the scheduler and its workers can run any code on this computer, and anyone with access to the scheduler's port can
run any code on its computer and on the workers. Use only schedulers of your own, in a network of your own, or with TLS: start
scheduler and workers with `--tls-ca-file`, `--tls-cert` and `--tls-key`, and give `--scheduler tls://host:8786 --tls-ca ca.pem
--tls-cert me.pem --tls-key me.key` here (`twin.Workers(scheduler=…, tls=twin.compute.parallel.Tls(…))`). Without these options Dask's
own configuration applies (`distributed.comm.tls.*`, `distributed.comm.require-encryption`). With them only certificates of that
authority are accepted, on both sides.

From a script: `twin.draw_machines(kinematics, trials=…, workers=twin.Workers(8))`, `twin.compensate_files(…)`.
"""

from twin.compute.parallel.run import Workers, map_as_completed, map_in_order
from twin.compute.parallel.tls import Tls

__all__ = ["Tls", "Workers", "map_as_completed", "map_in_order"]
