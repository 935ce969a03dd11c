"""Cross-check estimators on the sensor-error state and the measurement model of :mod:`srt`.

An estimator is a function ``(recording, options, progress) -> srt.Calibration`` registered in the entry-point group
``srt.estimators``. It takes its measurements and Jacobians from :mod:`srt.model.measurement_model` and
:mod:`srt.estimation.srt_measurements`, and imports neither the closed-form inversion nor the simulator: what checks the
closed form must not share it.
"""
