"""Functions of `import tetractl`, for notebooks and scripts.

    specs               load_spec, parse_spec, experiment_schema
    simulated_trials    run_trial; open_trial, for a script that steers by itself
    batches             run_batch, run_study
    logs                read_log, read_batch; to_arrays, to_dataframe
    checks              verify, summarise, compare
    drawings            plot, show, play_page

A function that needs a spec, a trial or a batch also accepts its file or folder. Slow libraries
(numba, matplotlib, pandas) are imported by the functions that need them. No function drives a lab:
only commands do, because their user can stop the robots.
"""
