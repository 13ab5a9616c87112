"""A bundle applied to frames: tracking, decoding, fault detection."""
