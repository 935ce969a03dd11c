"""From a recording to prepared sequences: stationary windows, manoeuvres, recognition, window means, unusable data."""
