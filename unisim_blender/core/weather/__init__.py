"""Weather in finished frames: fog, rain, snow, wet ground and spray, with the same parameters for cameras and LiDARs.

atmosphere.py    extinction and backscatter of air with droplets, drops and flakes
camera.py        attenuation and airlight
lidar.py         attenuated and lost returns, and returns of what is in the air
"""
