"""Addresses of AlpaSim's services. What leaves this machine goes through TLS."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Any

import grpc

from ...errors import UnisimError, refused

MOST_BYTES = 64 << 20
"""Of a message, as AlpaSim has it."""
LOCAL_SCHEMES = ("unix:", "unix-abstract:")


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine, reached by no network."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def host_of(address: str, option: str) -> str:
    """Return the host of "HOST:PORT", "" of a Unix socket. Raises `UnisimError` that names the option."""
    if address.startswith(LOCAL_SCHEMES):
        return ""
    host, colon, port = address.rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 1 << 16 or "/" in host:
        raise UnisimError(f"{option} {address}: must be HOST:PORT, or unix:PATH")
    return host


def channel_to(address: str, authority: Path | None, option: str) -> Any:
    """Return a channel to a service at an address: as plain text to this machine, else through TLS with the certificates of
    ``authority``, a PEM file. Raises `UnisimError`."""
    host = host_of(address, option)
    options = [
        ("grpc.max_send_message_length", MOST_BYTES),
        ("grpc.max_receive_message_length", MOST_BYTES),
        # a proxy of the environment is not asked to find what runs on this machine
        ("grpc.enable_http_proxy", 0),
    ]
    if authority is not None:
        credentials = grpc.ssl_channel_credentials(read_file(authority))
        return grpc.secure_channel(address, credentials, options=options)
    if host and not is_loopback(host):
        raise UnisimError(
            f"{option} {address}: is another machine, which takes TLS: give its certificate's authority with --driver-ca"
        )
    return grpc.insecure_channel(address, options=options)


def read_file(path: Path) -> bytes:
    """Return the bytes of a file. Raises `UnisimError`."""
    with refused(path, "read", UnisimError):
        return path.read_bytes()
