"""What is done to a virtual sensor: scenario files, virtual prints, and plans of samples."""
