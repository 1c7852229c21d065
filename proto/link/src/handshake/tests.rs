//! Coordinators with mutual TLS, and clients with and without certificates.

use std::net::SocketAddr;

use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpListener;
use tonic::Code;
use tonic::body::Body;
use tonic::codegen::{Service as _, http};
use tonic::service::Routes;
use tonic::transport::Server;
use tonic::transport::server::TcpIncoming;

use super::*;
use crate::testing::{TOKEN, ca, certificate, identity, private_file};
use crate::{ClientAccess, CoordinatorAccess, Link, Target, token_hash};

/// Whether the reason comes in time depends on the moment, so that one call proves little.
const CALLS: usize = 20;

/// Starts a coordinator that admits every certificate of an authority.
fn coordinator(client_ca: &str) -> SocketAddr {
    let (identity, hash) = (identity(), token_hash(TOKEN));
    let file = private_file(&format!(
        "{identity}client_ca = '''\n{client_ca}'''\n[[token]]\nrole = \"worker\"\nname = \"a\"\nblake3 = \"{hash}\"\n"
    ));
    let access = CoordinatorAccess::read(file.path()).unwrap();
    let incoming = TcpIncoming::bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let address = incoming.local_addr().unwrap();
    let mut server = Server::builder().tls_config(access.server_tls()).unwrap();
    tokio::spawn(server.add_routes(Routes::default()).serve_with_incoming(incoming));
    address
}

fn target(address: SocketAddr, with_certificate: bool) -> Target {
    let mut text = format!(
        "role = \"worker\"\nserver = \"https://{address}\"\nserver_name = \"localhost\"\ntoken = \"{TOKEN}\"\n\
         ca_certificate = '''\n{}'''\n",
        certificate()
    );
    if with_certificate {
        text += &identity();
    }
    let access = ClientAccess::read(private_file(&text).path()).unwrap();
    Target::new(Some(&access), None).unwrap()
}

/// A proxy to a server, whose first connection breaks before the server has objected to the certificate.
async fn breaking_once(server: SocketAddr) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(async move {
        let (client, _) = listener.accept().await.unwrap();
        pass_hellos(client, server).await.unwrap();
        loop {
            let (mut client, _) = listener.accept().await.unwrap();
            let mut server = TcpStream::connect(server).await.unwrap();
            tokio::spawn(async move { io::copy_bidirectional(&mut client, &mut server).await });
        }
    });
    address
}

/// Forwards the first bytes of each side, and nothing after that.
async fn pass_hellos(mut client: TcpStream, server: SocketAddr) -> io::Result<()> {
    let mut server = TcpStream::connect(server).await?;
    let mut bytes = vec![0; 1 << 16];
    let length = client.read(&mut bytes).await?;
    server.write_all(&bytes[..length]).await?;
    let length = server.read(&mut bytes).await?;
    client.write_all(&bytes[..length]).await?;
    client.read(&mut bytes).await.map(drop)
}

/// The status of a call to a method that does not exist.
async fn call(mut link: Link) -> Status {
    std::future::poll_fn(|context| link.poll_ready(context)).await.unwrap();
    let request = http::Request::post("/farm.v1.Leases/Nothing").body(Body::empty()).unwrap();
    match link.call(request).await {
        Ok(answer) => Status::from_header_map(answer.headers()).unwrap(),
        Err(error) => Status::from_error(error.into()),
    }
}

/// A client without a certificate, or with one of another authority, gets the reason at every call.
#[tokio::test]
async fn unaccepted_client_is_refused_each_call() {
    for (with_certificate, reason) in [(false, "--mutual"), (true, "does not accept")] {
        let target = target(coordinator(ca()), with_certificate);
        for n in 0..CALLS {
            let lazily = with_certificate || n % 2 == 0;
            let link = if lazily { target.connect_lazy() } else { target.connect().await.unwrap() };
            let status = call(link).await;
            assert_eq!(status.code(), Code::Unauthenticated, "call {n}: {status:?}");
            assert!(status.message().contains(reason), "{status:?}");
        }
    }
}

/// If the reason for a refusal was lost, it is requested by another handshake.
#[tokio::test]
async fn lost_refusal_is_asked_for_again() {
    for connect_lazily in [true, false] {
        let target = target(breaking_once(coordinator(ca())).await, false);
        let link = if connect_lazily { target.connect_lazy() } else { target.connect().await.unwrap() };
        let status = call(link).await;
        assert_eq!(status.code(), Code::Unauthenticated, "{status:?}");
    }
}

/// A coordinator that has ended is unavailable, and does not count as refusing.
#[tokio::test]
async fn ended_coordinator_refuses_no_client() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let target = target(listener.local_addr().unwrap(), false);
    drop(listener);
    assert!(target.handshake().unwrap().refusal().await.is_none());
    assert_eq!(call(target.connect_lazy()).await.code(), Code::Unavailable);
}

/// A coordinator that sends nothing is waited for only briefly.
#[tokio::test(start_paused = true)]
async fn silent_coordinator_is_abandoned_soon() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let target = target(listener.local_addr().unwrap(), false);
    let start = tokio::time::Instant::now();
    assert!(target.handshake().unwrap().refusal().await.is_none());
    assert_eq!(start.elapsed(), PATIENCE);
}
