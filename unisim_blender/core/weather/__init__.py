"""Weather in finished frames: fog, rain, snow and wet ground, with the same parameters for cameras and LiDARs.

atmosphere.py    extinction and backscatter of fog, sizes of drops and flakes
particles.py     drops and flakes, the same ones for every sensor
camera.py        attenuation and airlight, particles drawn
wet_ground.py    darker and glossier ground, weaker returns
spray.py         spray behind vehicles on wet ground
time_of_day.py   images as if the sun stood lower: a look
lidar.py         attenuated and lost returns, and returns of what is in the air
"""
