"""The verdict ``water``: backscatter in the projector's beam, attenuation and specks."""
