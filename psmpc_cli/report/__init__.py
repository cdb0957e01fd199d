"""Reports: claims and figures in one self-contained HTML page."""
