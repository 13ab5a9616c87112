"""Helpers that every package uses: kernels, threads, plain JSON values, worker pool, journal."""
