"""Gaussian-process regression with a squared-exponential kernel: one length-scale per input and learned noise.

Hyper-parameters are one vector per output, in logs: D length-scales, signal standard deviation, noise
standard deviation [R, E, D + 2]. Above a given number of points the posterior is the FITC approximation with
inducing inputs shared by the outputs (Snelson and Ghahramani, 2006). Replicas R first; float64.
"""
