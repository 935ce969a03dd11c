"""Calibrate a recording folder and correct its samples, in ten lines."""

import sims
import srt

simulation = sims.simulate(sims.load_scenario("demo"))  # or record your own unit
srt.write_recording(simulation.recording, "quickstart-recording", samples_format="npz", overwrite=True)

recording = srt.load_recording("quickstart-recording")
calibration = srt.calibrate(recording)
print(calibration.message)
for name in ("gyro_scale_x", "accel_misalignment_xy"):
    i = srt.INDEX[name]
    print(f"{name}: {calibration.errors[name] * 1e6:.0f} ± {calibration.sigma[i] * 1e6:.1f} ppm or µrad")
calibration.save("quickstart.json")
gyro, accel = srt.load_calibration("quickstart.json").apply(recording.gyro, recording.accel)
print("corrected rates and specific forces:", gyro.shape, accel.shape)
