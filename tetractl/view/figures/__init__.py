"""The figures of trials that `tetractl plot` draws.

Each is a file here, with a function that draws logs.

To add one, write its file, such as `apart.py` for `plot --kind apart`; a line in FIGURES of
`core/registries.py`; and one in the help of `cli/plot.py` and in docs/how-to/replay-and-plot.md.
The tests draw every figure and find texts that hide one another. This is a whole figure:

    import numpy as np

    from tetractl.core.errors import format_unit
    from tetractl.view import style
    from tetractl.view.figures.curves import TIME_LABEL, Curve, draw_curves, name_curves
    from tetractl.view.figures.trials import require_frames, one_trial

    @style.styled()
    def apart_figure(logs):
        '''Draw the distance between the first robot and each other one over time.'''
        log = one_trial(logs)
        require_frames(log)
        setup = log.start.setup
        figure = style.figure(style.PAGE_IN, 2.5)
        axes = figure.subplots()
        curves = []
        for robot in range(1, len(setup.names)):
            gaps = np.hypot(*(log.positions[:, robot] - log.positions[:, 0]).T)
            look = style.batch_look(robot)
            curves.append(Curve(gaps, look["color"], setup.names[robot], f"robot-{robot}"))
        draw_curves(axes, log.frames_s, curves)
        name_curves(axes, curves)
        label = f"distance from {setup.names[0]} [{format_unit(setup.unit)}]"
        axes.set(xlabel=TIME_LABEL, ylabel=label)
        return figure

`TrialLog` has the positions and times; `curves` draws and names one curve of each robot, `trials`
refuses what a figure cannot show, `axes` has logarithmic axes and `style` what all figures share.
`draw` draws a figure by its name, with its headline.
"""
