#!/bin/bash
# {name} in {shares} shares. Set the time and the options that your cluster requires, such as a
# partition, then:
#   sbatch THIS-FILE
# A share that reaches its time limit is stopped after its control step, queued again and continued.
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

export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1  # one thread per process
export TETRACTL_CACHE_DIR=/tmp/tetractl-$USER  # on the node: a shared home folder is slow

tetractl warm {study} || exit

{run} &
trap 'kill -TERM $!; wait $!; scontrol requeue "$SLURM_ARRAY_JOB_ID"_"$SLURM_ARRAY_TASK_ID"' TERM
wait $!
