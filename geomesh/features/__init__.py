"""Stages 1 to 3: gray image, Sobel, Canny edges, SIFT keypoints."""
