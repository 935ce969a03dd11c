"""Joint model: sensor errors, attitudes, fixture, gravity, moves and drift of a recording as unknowns of one system.

One :class:`~srt.joint.joint_model.JointModel` has the unknowns, measurements and noise of a recording;
:mod:`~srt.joint.linearisation` makes a linear system of it; a :class:`~srt.joint.solver.JointSolver` solves that, and
:mod:`~srt.joint.iteration` repeats both until the correction is negligible. Kalman filter and factor graph
(``estimators/``) are such solvers.
"""
