"""Simulated contacts: what the sensor would measure, to train and evaluate decoders."""
