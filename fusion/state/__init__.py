"""What the filter knows: states and covariance, process models that move them on, and clones of past yaws."""
