"""ISO programs (G-code) in the variants of Fanuc, LinuxCNC and Siemens 840D."""
