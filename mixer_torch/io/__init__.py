"""Files in and out: the only place that opens them. Writers write whole files or none."""
