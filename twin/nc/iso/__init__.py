"""ISO programs (G-code) in the flavours of Fanuc, LinuxCNC and Siemens 840D."""
