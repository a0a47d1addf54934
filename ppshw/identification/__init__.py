"""From a recording to a calibration: the paper's stepwise method and the joint estimate."""
