"""The job script that runs a study in shares on a cluster with Slurm."""

import shlex
from pathlib import Path

SCRIPT = """\
#!/bin/bash
# {name} in {shares} shares. Set the time and what your cluster asks for, such as a partition; then:
#   sbatch THIS-FILE
# A share that meets its walltime is stopped after its control step and queued again, and goes on.
# In the end, on any machine:
#   {merge}
#SBATCH --job-name={name}
#SBATCH --array=1-{shares}
#SBATCH --time=04:00:00
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --signal=B:TERM@60
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=slurm-%A_%a.out

export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1  # one thread a process
export TETRACTL_CACHE_DIR=/tmp/tetractl-$USER  # of the node: a shared home is slow

tetractl warm {study} || exit

{run} &
trap 'kill -TERM $!; wait $!; scontrol requeue "$SLURM_ARRAY_JOB_ID"_"$SLURM_ARRAY_TASK_ID"' TERM
wait $!
"""


def job_script(study: Path, name: str, shares: int, folder: Path, logs: str) -> str:
    """Return a job array with the given number of shares of a study, each in a folder next to
    `folder`."""
    part = shlex.quote(f"{folder}-shard")
    file, out = shlex.quote(str(study)), shlex.quote(str(folder))
    task = "$SLURM_ARRAY_TASK_ID"
    run = f'tetractl study {file} --shard "{task}/{shares}" --jobs 1 --quiet --logs {logs}'
    return SCRIPT.format(
        name=name,
        shares=shares,
        study=file,
        merge=f"tetractl study {file} --out {out} --merge {part}-*-of-{shares}",
        run=f'{run} \\\n    --out {part}-"{task}-of-{shares}"',
    )
