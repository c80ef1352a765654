"""Waters and cameras, which know wavelengths, and the medium that comes of them, which is curves of
distance and a width law.
"""
