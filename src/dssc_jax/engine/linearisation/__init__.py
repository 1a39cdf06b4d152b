"""The loop linearised part by part: where a part has a slope, and what stands for it where it has none."""
