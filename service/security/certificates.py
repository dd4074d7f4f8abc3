"""A private certificate authority in a directory, and the certificates that it issues.

The library `cryptography` makes them (extra ``secure``).
"""

from __future__ import annotations

import datetime
import ipaddress
import os
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from graspforce.core.whole_file import replace_file

AUTHORITY = "ca"
_KEY_USAGES = (
    *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
    *("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
)
_AUTHORITY_DAYS, _CERTIFICATE_DAYS = 3650, 825
_MAX_COMMON_NAME = 64  # characters
_CLOCK_TOLERANCE = datetime.timedelta(days=1)  # for machines whose clocks are late


def make_authority(directory: Path) -> None:
    """Write the key and the certificate of a new certificate authority: ``ca.key`` and ``ca.pem``.

    Args:
        directory: an existing directory.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"graspforce certificate authority {x509.random_serial_number():x}"[:_MAX_COMMON_NAME])
    usage = {name: name in ("key_cert_sign", "crl_sign") for name in _KEY_USAGES}
    builder = _builder(name, name, key.public_key(), _AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    _write(directory, AUTHORITY, key, builder.add_extension(x509.KeyUsage(**usage), critical=True).sign(key, hashes.SHA256()))


def issue_certificate(directory: Path, name: str, hosts: Sequence[str] = ()) -> None:
    """Write a new key and certificate: ``NAME.key`` and ``NAME.pem``. Existing ones are replaced.

    Args:
        directory: directory of the certificate authority.
        name: common name of the certificate, by which access is controlled.
        hosts: names and addresses of a server; empty for a client.
    """
    authority_key = serialization.load_pem_private_key((directory / f"{AUTHORITY}.key").read_bytes(), None)
    authority = x509.load_pem_x509_certificate((directory / f"{AUTHORITY}.pem").read_bytes())
    assert isinstance(authority_key, ec.EllipticCurvePrivateKey)  # `make_authority` wrote it
    key = ec.generate_private_key(ec.SECP256R1())
    use = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = _builder(_name(name), authority.subject, key.public_key(), _CERTIFICATE_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([use]), critical=False)
    builder = builder.add_extension(x509.SubjectAlternativeName([_host(host) for host in hosts or (name,)]), critical=False)
    _write(directory, name, key, builder.sign(authority_key, hashes.SHA256()))


def hosts_of(directory: Path, name: str) -> tuple[str, ...]:
    """Return the names and addresses in a certificate.

    Args:
        directory: its directory.
        name: its common name.
    """
    certificate = x509.load_pem_x509_certificate((directory / f"{name}.pem").read_bytes())
    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return tuple(str(each.value) for each in found)


def is_rotating(directory: Path) -> bool:
    """Return whether ``ca.pem`` has the certificates of two authorities.

    Args:
        directory: directory of the certificate authority.
    """
    return len(x509.load_pem_x509_certificates((directory / f"{AUTHORITY}.pem").read_bytes())) > 1


def begin_rotation(directory: Path) -> None:
    """Make a new authority beside the present one: ``ca.pem`` has both certificates, and ``ca.key`` the new key.

    Args:
        directory: directory of the certificate authority.
    """
    path = directory / f"{AUTHORITY}.pem"
    [old, *_] = x509.load_pem_x509_certificates(path.read_bytes())
    make_authority(directory)
    both = path.read_bytes() + old.public_bytes(serialization.Encoding.PEM)
    with replace_file(path) as temporary:
        temporary.write_bytes(both)


def end_rotation(directory: Path) -> None:
    """Remove the earlier authority from ``ca.pem``.

    Args:
        directory: directory of the certificate authority.
    """
    path = directory / f"{AUTHORITY}.pem"
    [newest, *_] = x509.load_pem_x509_certificates(path.read_bytes())
    with replace_file(path) as temporary:
        temporary.write_bytes(newest.public_bytes(serialization.Encoding.PEM))


def is_issued_by_newest(directory: Path, name: str) -> bool:
    """Return whether the newest authority of ``ca.pem`` issued a certificate.

    Args:
        directory: directory of the certificate authority.
        name: common name of the certificate.
    """
    [newest, *_] = x509.load_pem_x509_certificates((directory / f"{AUTHORITY}.pem").read_bytes())
    certificate = x509.load_pem_x509_certificate((directory / f"{name}.pem").read_bytes())
    try:
        certificate.verify_directly_issued_by(newest)
    except (InvalidSignature, ValueError, TypeError):
        return False
    return True


def _builder(subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int) -> x509.CertificateBuilder:
    """Return a certificate that is not signed yet."""
    now = datetime.datetime.now(datetime.timezone.utc)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_TOLERANCE)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _name(text: str) -> x509.Name:
    """Return a name with a common name only."""
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _host(text: str) -> x509.GeneralName:
    """Return the name or the address of a server."""
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _write(directory: Path, name: str, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
    """Write a key, readable by its owner only, and its certificate."""
    text = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    path = directory / f"{name}.key"
    os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))  # the mode before the content
    path.chmod(0o600)
    with replace_file(path) as temporary:
        temporary.write_bytes(text)
    with replace_file(directory / f"{name}.pem") as temporary:
        temporary.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
