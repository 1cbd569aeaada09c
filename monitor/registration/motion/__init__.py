"""One surface onto another: matches, stable areas, the motion, its covariance, what no shape holds."""
