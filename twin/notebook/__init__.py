"""In a notebook: calibrations and tables as pandas frames, errors over the volume as xarray data, plots to go on with, sliders.

    frame = twin.to_frame(calibration)                  # one row per number, with its standard uncertainty
    changed = twin.calibration_from_frame(frame, calibration)
    table = twin.to_frame(measurements, machine)        # the columns of the CSV file
    field = twin.error_field(kinematics, {"X": x, "Y": y})
    ax = twin.plot_curve(calibration, "E_XX")           # matplotlib axes
    twin.axis_sliders(kinematics)                       # a slider for each axis, with the machine and the error there

pandas, xarray and ipywidgets are the extra `notebook`: `pip install 'twin[notebook]'`. Nothing else of twin needs them.
"""
