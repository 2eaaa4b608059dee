"""The verdict on the water: backscatter in the projector's beam, attenuation and specks."""
